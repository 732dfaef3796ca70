// The live page in a real browser, at the sizes that long runs have. Needs `npm ci` in tests/web, and Chromium.
//
//     LEADTIME=target/release/leadtime node bench/page.mjs opened [UPDATES, default 10000]
//     LEADTIME=target/release/leadtime node bench/page.mjs replayed [UPDATES, default 200000] [SECONDS at their real pace, default 60]
//
// `opened`: a run makes that many updates, then watchers attach to it one after the other, and it is measured how long pages of them take, the first
// and later ones, from the moment at which the browser asks for the address; how soon a stream begins; how old an update is in the stream and on a page.
// `replayed`: what a page is told over eight hours (updates, playthrough, table of actors, head line, log) is told to one as fast as it reads, while it draws
// a twentieth of it, and the last minute at its real pace: how much memory it uses after that, and whether anything blocked it in that minute. A task is
// judged by the processor time that it took: by the clock it takes longer where others want the processor, too. Exit code 1 if a bound is missed.
import { createServer } from 'node:http';
import { once } from 'node:events';
import { gzipSync } from 'node:zlib';
import { join, resolve } from 'node:path';

process.env.LEADTIME = resolve(process.env.LEADTIME ?? 'target/release/leadtime');
const { Place, browse, until } = await import('../tests/web/support.mjs');
const IS_REPLAY = process.argv[2] === 'replayed';
const N_UPDATES = Number(process.argv[3] ?? (IS_REPLAY ? 200_000 : 10_000));
/** Bounds: milliseconds three times, bytes gzipped, bytes of memory, milliseconds. */
const BOUNDS = { complete: 2_000, event: 50, age: 300, sent: 2 ** 20, heap: 60e6, task: 100 };
/** Watchers, pages of each, streams that are begun, and updates whose age is looked at. */
const [WATCHERS, PAGES, STREAMS, AGES] = [3, 3, 20, 100];
/** Updates, and moments of the playthrough, that a page is told in a second, and the seconds that are told at their real pace. */
const [UPDATES, FRAMES, LAST] = [5, 10, Number(process.argv[4] ?? 60)];
const TINY = 'n_envs=4 n_steps=16 n_minibatches=1 n_epochs=1 total_steps=1e9'.split(' ').map((it) => `--set learner.${it}`).join(' ');

let missed = false;
/** Says whether a share of what was found, such as all or nine of ten, keeps within its bound. */
function tell(what, found, share, bound, unit, digits = 0) {
  const sorted = found.toSorted((a, b) => a - b);
  const judged = sorted[Math.ceil(share * sorted.length) - 1];
  missed ||= !(judged <= bound);
  const [middle, largest] = [sorted[Math.floor(sorted.length / 2)], sorted.at(-1)].map((number) => number.toFixed(digits));
  const all = sorted.length > 1 ? `median ${middle}, ${share < 1 ? `${share * 100} % up to ${judged.toFixed(digits)}, ` : ''}largest` : '';
  console.log(`${what}: ${all} ${largest} ${unit} (${judged <= bound ? '' : 'MISSED: '}${share < 1 ? `${share * 100} % ` : ''}at most ${bound} ${unit})`.replace(':  ', ': '));
}

/** The milliseconds since the page was asked for, once all panels have data. */
const filled = () => Number(document.documentElement.dataset.update ?? 0) > 0
  && ['actors-rows', 'books-rows', 'log-lines'].every((id) => (document.getElementById(id)?.children.length ?? 0) > 0)
  && (document.getElementById('flight-note')?.textContent ?? '') !== ''
  && performance.now();

/** Starts a run; returns its processes, and how a watcher reaches it. */
function train(place) {
  const socket = `unixsock-stream/${join(place.path, 'z')}`;
  const learner = place.start(`learner -c lander --name r ${TINY} --set run.checkpoint_every=1000 --listen ${socket} --status 127.0.0.1:0`);
  const actor = place.start(`actor --connect ${socket} --id a1`);
  return { learner, actor, socket };
}

/** Starts a watcher; returns the link of its page. */
const watch = (place, socket) => place.start(`watch --connect ${socket} --http 127.0.0.1:0`).page();

async function opened(chrome, place) {
  const { learner, socket } = train(place);
  const status = (await until('the status page', () => /http:\/\/[\d.:]+/.exec(learner.said)))[0];
  const made = async () => Number(/leadtime_updates_total\S* ([\d.e+]+)/.exec(await (await fetch(`${status}/metrics`)).text())?.[1] ?? 0);
  await until(`${N_UPDATES} updates`, async () => (await made()) >= N_UPDATES, 600_000);
  // Its own first page takes a browser longer, whatever is on it.
  await (await chrome.open(status)).context.close();
  let link = '';
  const [first, later] = [[], []];
  for (let i = 0; i < WATCHERS * PAGES; i++) {
    if (i % PAGES === 0) link = await watch(place, socket);
    const { page, context } = await chrome.open(link);
    const complete = await page.waitForFunction(filled, undefined, { polling: 20 });
    (i % PAGES ? later : first).push(await complete.jsonValue());
    await context.close();
  }
  const [text] = await streamed(link, 'history', 1);
  const { x } = JSON.parse(text);
  console.log(`a run of ${x.at(-1)} updates; curves: ${x.length} points, ${(text.length / 1e6).toFixed(2)} MB`);
  tell('page complete, the first one of a watcher', first, 1, BOUNDS.complete, 'ms');
  tell('page complete, later ones', later, 1, BOUNDS.complete, 'ms');
  const begun = [];
  for (let i = 0; i < STREAMS; i++) begun.push((await streamed(link, '', 1)).began);
  tell('first event of a stream', begun, 0.9, BOUNDS.event, 'ms');
  const { page } = await chrome.open(link);
  const ofPage = page.evaluate((n) => new Promise((done) => {
    const ages = [];
    new MutationObserver(() => ages.push(Number(document.documentElement.dataset.age)) === n && done(ages)).observe(document.documentElement, { attributeFilter: ['data-update'] });
  }), AGES);
  const ofStream = (await streamed(link, 'update', AGES + 1)).ages.slice(1);
  tell('age of an update in the stream', ofStream, 0.9, BOUNDS.age, 'ms');
  tell('age of an update on the page', await ofPage, 0.9, BOUNDS.age, 'ms');
  tell('curves, gzipped', [gzipSync(text).length], 1, BOUNDS.sent, 'bytes');
}

/** So many events of a kind as text, or of all kinds; when the first bytes came; and how old those were that say when they were made. */
async function streamed(link, kind, n) {
  const asked = performance.now();
  const control = new AbortController();
  const answer = await fetch(`${link}events${kind && `?only=${kind}`}`, { signal: control.signal });
  const [decoder, events] = [new TextDecoder(), Object.assign([], { began: 0, ages: [] })];
  let text = '';
  for await (const chunk of answer.body) {
    events.began ||= performance.now() - asked;
    text += decoder.decode(chunk, { stream: true });
    const blocks = text.split('\n\n');
    text = blocks.pop();
    for (const block of blocks) {
      events.push(/^data: (.*)/m.exec(block)[1]);
      const made = /"made":([\d.]+)/.exec(block);
      if (made) events.ages.push(Date.now() - 1000 * made[1]);
    }
    if (events.length >= n) break;
  }
  control.abort();
  return events;
}

/** What a page is told, by kind, from a run at work. */
async function recorded(link) {
  const answer = await fetch(`${link}events`);
  const [decoder, kinds] = [new TextDecoder(), {}];
  let text = '';
  for await (const chunk of answer.body) {
    text += decoder.decode(chunk, { stream: true });
    const blocks = text.split('\n\n');
    text = blocks.pop();
    for (const block of blocks) {
      const [, kind, data] = /event: (\w+)\ndata: (.*)/s.exec(block);
      (kinds[kind] ??= []).push(JSON.parse(data));
    }
    // A whole episode, from its beginning on.
    if (kinds.flight?.length > 2) return kinds;
  }
  throw new Error('the watcher has ended');
}

const written = (kind, data) => `event: ${kind}\ndata: ${JSON.stringify(data)}\n\n`;

/** Everything that is told of one update: itself, moments of the playthrough, and now and then the rest. */
function told(kinds, update, counts) {
  const like = kinds.update[update % kinds.update.length];
  const scalars = Object.fromEntries(Object.entries(like.scalars).map(([name, value]) => [name, value * (1 + 0.3 * Math.sin(update / 500))]));
  let text = written('update', { ...like, update, steps: update * 64, elapsed: update / UPDATES, scalars });
  if (update % UPDATES === 0) {
    text += written('state', { ...kinds.state[0], update, steps: update * 64 }) + written('actors', kinds.actors.at(-1));
    text += update % 50 ? '' : written('log', [{ number: ++counts.log, at: 1769860800 + update, level: 'info', text: `actor a${update} joined` }]);
  }
  for (let i = 0; i < FRAMES / UPDATES; i++) {
    const at = counts.frames++ % kinds.frame.length;
    if (at === 0) text += written('flight', { ...kinds.flight[1], flight: ++counts.flights });
    text += written('frame', { ...kinds.frame[at], flight: counts.flights });
  }
  return text;
}

/** The tasks of the pages' main threads, with their microseconds by the clock and of the processor. */
function tasksOf(traced) {
  const threads = traced.filter((event) => event.name === 'thread_name' && event.args.name === 'CrRendererMain');
  const ids = new Set(threads.map((thread) => `${thread.pid} ${thread.tid}`));
  return traced.filter((event) => event.name === 'RunTask' && ids.has(`${event.pid} ${event.tid}`) && event.tdur !== undefined);
}

/** Serves the page of a watcher with other events; resolves when the last one has been told. */
function replay(link, kinds, begin) {
  let [isLast, isOver, isRead] = [() => {}, () => {}, false];
  const [last, end] = [new Promise((done) => (isLast = done)), new Promise((done) => (isOver = done))];
  const server = createServer(async (question, answer) => {
    if (!question.url.startsWith('/events')) {
      const asset = await fetch(new URL(question.url, link));
      answer.writeHead(asset.status, { 'content-type': asset.headers.get('content-type') ?? '' });
      return answer.end(Buffer.from(await asset.arrayBuffer()));
    }
    if (isRead) return answer.writeHead(503).end();
    isRead = true;
    answer.writeHead(200, { 'content-type': 'text/event-stream' });
    answer.flushHeaders();
    await begin;
    const counts = { log: 1e6, frames: 0, flights: 1e6 };
    answer.write(written('about', kinds.about[0]) + written('history', { ...kinds.history[0], from: 0, to: 0, stride: 1, x: [], scalars: {}, marks: [] }));
    for (let update = 1; update <= N_UPDATES; update++) {
      if (update === N_UPDATES - LAST * UPDATES) isLast();
      if (update >= N_UPDATES - LAST * UPDATES) await new Promise((done) => setTimeout(done, 1000 / UPDATES));
      if (!answer.write(told(kinds, update, counts))) await once(answer, 'drain');
    }
    isOver();
    // A page that hears nothing asks again.
    setInterval(() => answer.write(written('state', kinds.state[0])), 1000).unref();
  });
  return { server, last, end };
}

async function replayed(chrome, place) {
  const { learner, actor, socket } = train(place);
  const link = await watch(place, socket);
  const kinds = await recorded(link);
  // What is told from here on is made here: the processor is the page's.
  await Promise.all([actor.kill(), learner.kill()]);
  // The moments of the episode in the middle.
  kinds.frame = kinds.frame.filter((it) => it.flight === kinds.flight[1].flight);
  let isOpen = () => {};
  const { server, last, end } = replay(link, kinds, new Promise((done) => (isOpen = done)));
  server.listen(0, '127.0.0.1');
  await once(server, 'listening');
  const began = performance.now();
  const { page, context } = await chrome.open(`http://127.0.0.1:${server.address().port}/`);
  await page.evaluate(() => {
    let looks = 0;
    Object.defineProperty(document, 'hidden', { configurable: true, get: () => ++looks % 20 > 0 });
  });
  isOpen();
  await last;
  console.log(`${N_UPDATES - LAST * UPDATES} updates told in ${((performance.now() - began) / 1000).toFixed(0)} s`);
  await page.waitForFunction((update) => Number(document.documentElement.dataset.update ?? 0) >= update, N_UPDATES - LAST * UPDATES - 50);
  console.log(`and taken in ${((performance.now() - began) / 1000).toFixed(0)} s after it was opened`);
  await page.evaluate(() => Object.defineProperty(document, 'hidden', { get: () => false }));
  await chrome.browser.startTracing(page, { categories: ['disabled-by-default-devtools.timeline', '__metadata'] });
  await end;
  await until('the last update', () => page.evaluate((update) => document.documentElement.dataset.update === String(update), N_UPDATES));
  const tasks = tasksOf(JSON.parse(await chrome.browser.stopTracing()).traceEvents);
  const devtools = await context.newCDPSession(page);
  await devtools.send('HeapProfiler.enable');
  await devtools.send('HeapProfiler.collectGarbage');
  const { usedSize } = await devtools.send('Runtime.getHeapUsage');
  const points = await page.evaluate(() => document.querySelectorAll('#log-lines li').length);
  const longest = Math.max(...tasks.map((task) => task.dur)) / 1e3;
  console.log(`${tasks.length} tasks in the last ${LAST} s, the longest by the clock ${longest.toFixed(0)} ms; ${points} lines in the log`);
  tell('processor time of a task', tasks.map((task) => task.tdur / 1e3), 1, BOUNDS.task, 'ms');
  tell('memory of the page', [usedSize / 1e6], 1, BOUNDS.heap / 1e6, 'MB', 1);
  server.closeAllConnections();
  server.close();
}

const [chrome, place] = [await browse(), new Place()];
// The browser's own handlers would close it and let this wait for it.
for (const signal of ['SIGTERM', 'SIGINT']) {
  process.removeAllListeners(signal);
  process.once(signal, () => {
    for (const running of place.processes) running.kill();
    process.exit(130);
  });
}
try {
  await (IS_REPLAY ? replayed : opened)(chrome, place);
} finally {
  await chrome.close();
  await place.clean();
}
process.exitCode = missed ? 1 : 0;
