// What the browser tests share: the program, a browser, and waiting with a limit.
import { spawn } from 'node:child_process';
import { mkdtempSync, rmSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join, resolve } from 'node:path';
import { chromium } from 'playwright-core';

const PROGRAM = resolve(process.env.LEADTIME ?? '../../target/debug/leadtime');
const CHROMIUM = process.env.CHROMIUM ?? '/usr/bin/chromium';
/** The longest that anything may take, in milliseconds. */
export const PATIENCE = 60_000;
/** Without them the browser asks hosts of its own. */
const QUIET = ['--no-sandbox', '--disable-background-networking', '--disable-component-update', '--disable-sync', '--disable-quic'];

/** Waits until a condition holds, and returns what it gave. */
export async function until(what, condition, patience = PATIENCE) {
  const deadline = Date.now() + patience;
  for (;;) {
    const found = await condition();
    if (found) return found;
    if (Date.now() > deadline) throw new Error(`not in time: ${what}`);
    await new Promise((done) => setTimeout(done, 50));
  }
}

/** A started process, with what it said. */
export class Running {
  constructor(args, cwd) {
    this.said = '';
    this.child = spawn(PROGRAM, args, { cwd, stdio: ['ignore', 'pipe', 'pipe'] });
    for (const stream of [this.child.stdout, this.child.stderr]) stream.on('data', (text) => (this.said += text));
    this.ended = new Promise((done, fail) => this.child.on('exit', (code) => done(code)).on('error', fail));
  }

  /** The link of the page that it serves. */
  async page() {
    const found = await until(`the page's link in: ${this.said}`, () => /page {5}(http:\S+)/.exec(this.said), 30_000);
    return found[1];
  }

  async stop() {
    // One that is halted goes on, to end.
    if (this.child.exitCode === null) for (const signal of ['SIGTERM', 'SIGCONT']) this.child.kill(signal);
    return await this.ended;
  }

  kill() {
    this.child.kill('SIGKILL');
    return this.ended;
  }
}

/** A place of one's own for a test: runs, sockets, processes; all of it is gone at its end. */
export class Place {
  constructor() {
    this.path = mkdtempSync(join(tmpdir(), 'lt-'));
    this.processes = [];
  }

  start(...args) {
    const running = new Running(args.flatMap((text) => text.split(' ')), this.path);
    this.processes.push(running);
    return running;
  }

  async clean() {
    for (const running of this.processes) await running.stop();
    rmSync(this.path, { recursive: true, force: true });
  }
}

/** A browser in which whatever goes wrong is kept. */
export async function browse() {
  const browser = await chromium.launch({ executablePath: CHROMIUM, args: QUIET });
  return {
    browser,
    /** Opens a page; every complaint of it is a failure, and so is a question to another host. */
    async open(link, options = {}) {
      const context = await browser.newContext({ viewport: { width: 1280, height: 720 }, ...options });
      const page = await context.newPage();
      // The machine may be busy with the run itself.
      page.setDefaultTimeout(120_000);
      const complaints = [];
      const host = new URL(link).host;
      await page.route('**', (route) => {
        if (new URL(route.request().url()).host === host) return route.continue();
        complaints.push(`asked another host: ${route.request().url()}`);
        return route.abort();
      });
      page.on('console', (message) => ['error', 'warning'].includes(message.type()) && complaints.push(message.text()));
      page.on('pageerror', (error) => complaints.push(String(error)));
      page.on('response', (answer) => answer.status() >= 400 && complaints.push(`${answer.status()} ${answer.url()}`));
      await page.goto(link);
      return { page, complaints, context };
    },
    close: () => browser.close(),
  };
}
