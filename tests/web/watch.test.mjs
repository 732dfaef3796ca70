// The live page in a real browser: `LEADTIME=PROGRAM node --test`.
import assert from 'node:assert/strict';
import { createHash } from 'node:crypto';
import { execFileSync } from 'node:child_process';
import { readFileSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { after, before, test } from 'node:test';
import { Place, browse, until } from './support.mjs';

const ASSETS = '../../crates/watch/assets';
/** A run that lasts for minutes, unless it is ended. */
const LONG = 'up -c cartpole --actors 2 --steps 5e7 --name long --set run.checkpoint_every=5 --set learner.n_steps=32';
/** One that takes seconds. */
const SHORT = 'up -c cartpole --actors 2 --steps 2e4 --name short';
/** One that lasts for longer than a page takes to open. */
const MEDIUM = 'up -c cartpole --actors 2 --steps 2e5 --name medium';
const PANELS = ['curves', 'flight', 'staleness', 'phases', 'actors', 'books', 'log'];

let chrome;
before(async () => (chrome = await browse()));
after(() => chrome.close());

const text = (page, id) => page.locator(`#${id}`).innerText();
const state = (page) => text(page, 'state');
const newest = (page) => page.evaluate(() => Number(document.documentElement.dataset.update ?? 0));

/** Waits until the page shows a run at work. */
async function complete(page, patience) {
  await until('the page is complete', async () => {
    const [updates, actors, books] = await Promise.all([newest(page), page.locator('#actors-rows tr').count(), page.locator('#books-rows tr').count()]);
    return updates > 0 && actors > 0 && books > 0;
  }, patience);
}

/** Trains a short run, and opens its page. */
async function finished(t, settings = '') {
  const place = new Place();
  t.after(() => place.clean());
  assert.equal(await place.start(`${SHORT} ${settings}`.trim()).ended, 0);
  const opened = await chrome.open(await place.start('watch runs/short --http 127.0.0.1:0').page());
  await until('the run', async () => (await newest(opened.page)) > 0);
  return { place, ...opened };
}

test('the vendored library is the one of the registry', () => {
  const digest = (path) => createHash('sha256').update(readFileSync(path)).digest('hex');
  for (const [ours, theirs] of [['uPlot-1.6.32.min.js', 'uPlot.iife.min.js'], ['uPlot.css', 'uPlot.min.css']]) {
    assert.equal(digest(join(ASSETS, 'vendor', ours)), digest(join('node_modules/uplot/dist', theirs)));
  }
});

test('a run at work: complete at once, on one screen, light and dark, wide and narrow', async (t) => {
  const place = new Place();
  t.after(() => place.clean());
  const link = await place.start(LONG, '--watch 127.0.0.1:0').page();
  const first = await chrome.open(link);
  await complete(first.page);
  // Who comes in the middle sees all of it.
  await until('some history', async () => (await newest(first.page)) > 40);
  const opened = Date.now();
  const { page, complaints } = await chrome.open(link);
  await complete(page, 20_000);
  t.diagnostic(`complete ${Date.now() - opened} ms after it was opened`);
  const points = await page.evaluate(() => document.querySelectorAll('.chart canvas').length);
  assert.equal(points, 8, 'eight charts');
  assert.match(await state(page), /training/);
  assert.match(await text(page, 'balance'), /^balanced$/);

  await t.test('every panel is on the first screen', async () => {
    for (const id of PANELS) {
      const box = await page.locator(`#${id}`).boundingBox();
      assert.ok(box && box.y >= 0 && box.y + box.height <= 720 && box.x + box.width <= 1280 && box.height > 80, `${id}: ${JSON.stringify(box)}`);
    }
    assert.equal(await page.evaluate(() => document.documentElement.scrollHeight > innerHeight), false);
  });

  await t.test('a narrow screen has no horizontal scroll', async () => {
    for (const colorScheme of ['light', 'dark']) {
      const narrow = await chrome.open(link, { viewport: { width: 390, height: 844 }, colorScheme });
      await complete(narrow.page);
      assert.equal(await narrow.page.evaluate(() => document.documentElement.scrollWidth), 390);
      assert.deepEqual(narrow.complaints, []);
      await narrow.context.close();
    }
  });

  await t.test('text is legible in light and dark', async () => {
    for (const colorScheme of ['light', 'dark']) {
      const seen = await chrome.open(link, { colorScheme });
      await complete(seen.page);
      const faint = await seen.page.evaluate(illegible);
      assert.deepEqual(faint, [], colorScheme);
      await seen.context.close();
    }
  });

  await t.test('the keyboard reaches everything', async () => {
    const reached = new Set();
    for (let i = 0; i < 40; i++) {
      await page.keyboard.press('Tab');
      reached.add(await page.evaluate(() => document.activeElement?.id || document.activeElement?.textContent || ''));
    }
    for (const wanted of ['axis', 'charts', 'zones', 'pause', 'log-lines', 'steps/s']) assert.ok(reached.has(wanted), `${wanted} in ${[...reached]}`);
    await page.locator('#charts').focus();
    await page.keyboard.press('+');
    assert.equal(await page.locator('#unzoom').isVisible(), true, 'zoomed');
    // Data that arrive move nothing.
    const before = await newest(page);
    await until('more updates', async () => (await newest(page)) > before + 3);
    assert.equal(await page.locator('#unzoom').isVisible(), true, 'still zoomed');
    await page.keyboard.press('0');
    assert.equal(await page.locator('#unzoom').isVisible(), false);
  });

  await t.test('what the keyboard stops at has a role and a name', async () => {
    const nameless = await page.evaluate(() => {
      const stops = [...document.querySelectorAll('[tabindex="0"]')];
      const isNamed = (stop) => stop.getAttribute('aria-label') && (stop.getAttribute('role') || stop.tagName === 'OL');
      return stops.filter((stop) => !isNamed(stop)).map((stop) => stop.outerHTML.slice(0, 80));
    });
    assert.deepEqual(nameless, []);
  });

  await t.test('who has a finger alone is not told to drag', async () => {
    assert.equal(await page.locator('#curves-hint').isVisible(), true);
    const tablet = await chrome.open(link, { viewport: { width: 820, height: 1180 }, hasTouch: true, isMobile: true });
    await complete(tablet.page);
    assert.equal(await tablet.page.evaluate(() => matchMedia('(pointer: coarse)').matches), true);
    assert.equal(await tablet.page.locator('#curves-hint').isVisible(), false);
    await tablet.context.close();
  });

  await t.test('curves are there as text', async () => {
    await page.locator('button[data-text=curves]').click();
    assert.ok((await page.locator('#curves-text tr').count()) > 5);
    const [heads, columns] = [page.locator('#curves-text th'), page.locator('#curves-text th[scope=col]')];
    assert.equal(await columns.count(), await heads.count(), 'every head is of its column');
    assert.equal(await page.locator('#curves-hint').isVisible(), false, 'a table does not zoom');
    await page.locator('button[data-text=curves]').click();
  });

  await t.test('staleness as text fits into its panel', async () => {
    const button = page.locator('button[data-text=staleness]');
    await button.click();
    // Where the panel is narrowest its table scrolls.
    for (const [width, parts] of [[1100, 'button'], [1280, 'button, th']]) {
      await page.setViewportSize({ width, height: 720 });
      const cut = await page.locator('#staleness').evaluate((panel, wanted) => {
        const edge = panel.getBoundingClientRect().right;
        return [...panel.querySelectorAll(wanted)].filter((part) => part.getBoundingClientRect().right > edge).map((part) => part.textContent);
      }, parts);
      assert.deepEqual(cut, [], `${width}`);
    }
    await button.click();
  });

  await t.test('an update says how old it is when the page has it', async () => {
    const ages = [];
    for (let i = 0; i < 20; i++) {
      const before = await newest(page);
      await until('an update', async () => (await newest(page)) > before);
      ages.push(await page.evaluate(() => Number(document.documentElement.dataset.age)));
    }
    ages.sort((a, b) => a - b);
    t.diagnostic(`age of an update on the page: median ${ages[10]} ms, largest ${ages[19]} ms`);
    // How old it may be is judged by bench/page.mjs.
    assert.ok(ages.every((age) => Number.isFinite(age)), `${ages}`);
  });
  assert.deepEqual(complaints, []);
  assert.deepEqual(first.complaints, []);
});

test('an actor that is killed is struck through, and a learner that is killed comes back without duplicates', async (t) => {
  const place = new Place();
  t.after(() => place.clean());
  const socket = `unixsock-stream/${join(place.path, 'z')}`;
  const learner = `learner -c cartpole --steps 5e7 --name r --set run.checkpoint_every=5 --set learner.n_steps=32 --listen ${socket}`;
  const first = place.start(learner);
  const actors = ['a', 'b'].map((id) => place.start(`actor --connect ${socket} --id ${id}`));
  const link = await place.start(`watch --connect ${socket} --http 127.0.0.1:0`).page();
  const { page, complaints } = await chrome.open(link);
  await complete(page);
  await until('both actors', async () => (await page.locator('#actors-rows tr:not(.gone)').count()) === 2);
  await actors[1].kill();
  await page.locator('tr.gone[data-actor=b]').waitFor({ timeout: 20_000 });

  await first.kill();
  await until('the learner is missed', async () => (await state(page)).includes('lost'));
  place.start(learner);
  await until('training again', async () => (await state(page)).includes('training'));
  const before = await newest(page);
  await until('more updates', async () => (await newest(page)) > before + 10);
  const history = await page.evaluate(async () => {
    const answer = await fetch('state.json');
    return (await answer.json()).history;
  });
  assert.ok(history.x.every((x, i) => i === 0 || x > history.x[i - 1]), 'no update twice');
  assert.ok(history.marks.length >= 1, 'the resume is marked');
  assert.deepEqual(complaints, []);
});

test('an actor that stands still is red, or struck through once it counts as gone, and comes back', async (t) => {
  const place = new Place();
  t.after(() => place.clean());
  const socket = `unixsock-stream/${join(place.path, 'z')}`;
  place.start(`learner -c cartpole --steps 5e7 --name r --set run.checkpoint_every=5 --set learner.n_steps=32 --listen ${socket}`);
  const [frozen] = ['a', 'b'].map((id) => place.start(`actor --connect ${socket} --id ${id}`));
  const link = await place.start(`watch --connect ${socket} --http 127.0.0.1:0`).page();
  const { page, complaints } = await chrome.open(link);
  await complete(page);
  const well = (id) => page.locator(`tr[data-actor=${id}]:not(.gone, .silent)`).count();
  await until('both actors', async () => (await well('a')) + (await well('b')) === 2);
  // It is silent and gone within two seconds, in this order; the page is told once a second, and may be told of the end only.
  const stopped = Date.now();
  frozen.child.kill('SIGSTOP');
  const row = page.locator('tr.silent[data-actor=a], tr.gone[data-actor=a]');
  await row.waitFor({ timeout: 20_000 });
  t.diagnostic(`${await row.getAttribute('class')} ${Date.now() - stopped} ms after it was stopped`);
  frozen.child.kill('SIGCONT');
  await until('it is back', async () => (await well('a')) === 1);
  assert.deepEqual(complaints, []);

  // What the page shows of one that is silent and not yet gone.
  const events = await page.evaluate(async () => {
    const { update, history, actors } = await (await fetch('state.json')).json();
    const shown = actors.map((actor) => ({ ...actor, gone_s: null, is_silent: actor.id === 'a', silent_s: actor.id === 'a' ? 2.5 : 0.5 }));
    const told = [['history', history], ['update', update], ['actors', shown]];
    return told.map(([kind, data]) => `event: ${kind}\ndata: ${JSON.stringify(data)}\n\n`).join('');
  });
  await page.route('**/events', (route) => route.fulfill({ contentType: 'text/event-stream', body: events }));
  await page.reload();
  await page.locator('tr.silent[data-actor=a]').waitFor();
  const colours = await page.evaluate(() => {
    const cells = ['tr.silent[data-actor=a] td', 'tr[data-actor=b] td'].map((cell) => document.querySelector(cell));
    const bad = document.createElement('p');
    bad.className = 'bad';
    document.body.append(bad);
    return [...cells, bad].map((element) => getComputedStyle(element).color);
  });
  assert.equal(colours[0], colours[2], 'red');
  assert.notEqual(colours[1], colours[2], 'the other one is not');
});

test('a finished run: the page stays and says so, live and from the disk', async (t) => {
  const place = new Place();
  t.after(() => place.clean());
  const run = place.start(MEDIUM, '--watch 127.0.0.1:0');
  const { page } = await chrome.open(await run.page());
  await complete(page);
  assert.equal(await run.ended, 0, run.said);
  await until('the end', async () => (await state(page)).includes('finished'));
  assert.ok((await newest(page)) > 0, 'what it showed is still there');
  assert.equal(await text(page, 'left'), 'none');

  const link = await place.start('watch runs/medium --http 127.0.0.1:0').page();
  const disk = await chrome.open(link);
  await until('the run on the disk', async () => (await state(disk.page)) === 'finished' && (await newest(disk.page)) > 0);
  assert.deepEqual(disk.complaints, []);
});

test('a watcher that is silent is told, and one that comes after it on the same port begins anew', async (t) => {
  const place = new Place();
  t.after(() => place.clean());
  assert.equal(await place.start(SHORT).ended, 0);
  const first = place.start(LONG, '--watch 127.0.0.1:0');
  const link = await first.page();
  const { page } = await chrome.open(link);
  await complete(page);
  await until('a log', async () => (await page.locator('#log-lines li').count()) > 2);
  first.child.kill('SIGSTOP');
  await until('silence', async () => (await state(page)).includes('silent'), 20_000);
  first.child.kill('SIGCONT');
  await until('training again', async () => (await state(page)) === 'training');

  assert.equal(await first.stop(), 130);
  place.start(`watch runs/short --http ${new URL(link).host}`);
  await until('the other run', async () => (await text(page, 'run')) === 'short' && (await newest(page)) > 0);
  assert.deepEqual(await page.locator('#log-lines li').evaluateAll((lines) => lines.map((line) => line.lastChild.textContent)), ['the run is finished']);
  // The curves are those of the other run, to its last step.
  await page.locator('button[data-text=curves]').click();
  const last = Number((await page.locator('#curves-text tr:last-child td').first().innerText()).replaceAll(',', ''));
  const told = await page.evaluate(async () => (await (await fetch('state.json')).json()).state.steps);
  assert.equal(last, told);
});

test('a number that is far too large does not stop the page', async (t) => {
  const place = new Place();
  t.after(() => place.clean());
  assert.equal(await place.start(SHORT).ended, 0);
  const metrics = join(place.path, 'runs/short/metrics.jsonl');
  const lines = readFileSync(metrics, 'utf8').trimEnd().split('\n').map((line) => JSON.parse(line));
  lines.at(-1).staleness = { 0: 3, 1000000000: 1 };
  writeFileSync(metrics, lines.map((line) => `${JSON.stringify(line)}\n`).join(''));
  const { page, complaints } = await chrome.open(await place.start('watch runs/short --http 127.0.0.1:0').page());
  await until('the run', async () => (await newest(page)) > 0);
  await page.locator('button[data-text=staleness]').click();
  assert.match(await text(page, 'staleness-text'), /1000000000/);
  assert.deepEqual(complaints, []);
});

test('a gap between the first updates takes no points from the curves', async (t) => {
  const { page } = await finished(t);
  // A watcher that came at the first update, was told none for a while, and then ten.
  const events = await page.evaluate(async () => {
    const { update, history } = await (await fetch('state.json')).json();
    const scalars = Object.fromEntries(Object.keys(history.scalars).map((name) => [name, { min: [0, 0], max: [0, 0] }]));
    const told = [['history', { ...history, from: 0, to: 300, x: [1, 300], scalars }]];
    for (let i = 1; i <= 10; i++) told.push(['update', { ...update, update: 300 + i }]);
    return told.map(([kind, data]) => `event: ${kind}\ndata: ${JSON.stringify(data)}\n\n`).join('');
  });
  await page.route('**/events', (route) => route.fulfill({ contentType: 'text/event-stream', body: events }));
  await page.reload();
  await until('the last update', async () => (await newest(page)) === 310);
  await page.locator('button[data-text=curves]').click();
  assert.equal(await page.locator('#curves-text tbody tr').count(), 12);
});

test('as text a curve has the values of the picture', async (t) => {
  const { page } = await finished(t);
  // Each point stands for two updates.
  const body = await page.evaluate(async () => {
    const { history } = await (await fetch('state.json')).json();
    const scalars = { ...history.scalars, 'episodes/success': { min: [0, 0.2, 0.4], max: [0.8, 0.9, 1] } };
    return `event: history\ndata: ${JSON.stringify({ ...history, from: 0, to: 6, stride: 2, x: [2, 4, 6], scalars })}\n\n`;
  });
  await page.route('**/events', (route) => route.fulfill({ contentType: 'text/event-stream', body }));
  await page.reload();
  const shown = page.locator('.chart h3 b');
  await until('the middle of the last point', async () => (await shown.first().innerText()) === '0.700');
  const headings = (await shown.allInnerTexts()).flatMap((values) => values.split(', '));
  await page.locator('button[data-text=curves]').click();
  const last = await page.locator('#curves-text tbody tr:last-child td').allInnerTexts();
  assert.deepEqual(last.slice(1), headings);
});

test('where the schedule is asynchronous, the clipped share stands by the staleness', async (t) => {
  const { page, complaints } = await finished(t, '--set learner.mode=async');
  assert.match(await text(page, 'clip-shares'), /^clipped: \d+: \d+\.\d %/);
  await page.locator('button[data-text=staleness]').click();
  assert.match(await text(page, 'staleness-text'), /clipped/);
  const box = await page.locator('#staleness').boundingBox();
  assert.ok(box.y + box.height <= 720, JSON.stringify(box));
  assert.deepEqual(complaints, []);
});

test('a token is needed where it is asked for', async (t) => {
  const place = new Place();
  t.after(() => place.clean());
  assert.equal(await place.start(SHORT).ended, 0);
  const link = await place.start('watch runs/short --http 127.0.0.1:0 --token auto').page();
  assert.match(link, /#token=[0-9a-f]{32}$/);
  const { page, complaints } = await chrome.open(link);
  await until('the run', async () => (await newest(page)) > 0);
  assert.deepEqual(complaints, []);
  const without = await chrome.open(link.split('#')[0]);
  await until('a refusal', async () => (await state(without.page)).includes('token'));
});

test('a playthrough speaks', async (t) => {
  const place = new Place();
  t.after(() => place.clean());
  const link = await place.start('up -c lander --actors 2 --name fly --watch 127.0.0.1:0').page();
  const { page, complaints } = await chrome.open(link);
  await until('words', async () => (await text(page, 'heard')).length > 3);
  const painted = await page.evaluate(() => {
    const canvas = document.querySelector('#stage');
    const pixels = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
    return new Set(new Uint32Array(pixels.buffer)).size;
  });
  assert.ok(painted > 5, `${painted} colours`);
  assert.match(await text(page, 'flight-note'), /version \d+, episode \d+/);
  assert.deepEqual(complaints, []);
});

test('what another watcher does not know of its run is not shown of the one before', async (t) => {
  const place = new Place();
  t.after(() => place.clean());
  assert.equal(await place.start(SHORT).ended, 0);
  const { page } = await chrome.open(await place.start('watch runs/short --http 127.0.0.1:0').page());
  await until('books', async () => (await text(page, 'balance')) === 'balanced');
  await page.locator('#charts').focus();
  await page.keyboard.press('+');
  assert.equal(await page.locator('#unzoom').isVisible(), true, 'zoomed');
  const { update, about } = await page.evaluate(async () => (await fetch('state.json')).json());
  const told = [['about', { ...about, watcher: 1 }], ['update', { ...update, books: null }]];
  const body = told.map(([kind, data]) => `event: ${kind}\ndata: ${JSON.stringify(data)}\n\n`).join('');
  await page.route('**/events', (route) => route.fulfill({ contentType: 'text/event-stream', body }));
  // The page goes on, and asks the next watcher once this one is gone.
  await place.processes.at(-1).kill();
  await until('no books', async () => (await page.locator('#books-rows tr').count()) === 0);
  assert.equal(await text(page, 'balance'), '');
  assert.equal(await page.locator('#unzoom').isVisible(), false, 'the whole run');
});

test('seconds that pass are not read aloud, and the keys of the browser stay its own', async (t) => {
  const { place, page } = await finished(t);
  const isPrevented = (options) =>
    page.evaluate((given) => {
      const event = new KeyboardEvent('keydown', { bubbles: true, cancelable: true, ...given });
      return !document.querySelector('#charts').dispatchEvent(event);
    }, options);
  assert.equal(await isPrevented({ key: 'ArrowLeft' }), false, 'nothing to move');
  assert.equal(await isPrevented({ key: '+' }), true);
  assert.equal(await isPrevented({ key: 'ArrowLeft' }), true);
  assert.equal(await isPrevented({ key: 'ArrowLeft', altKey: true }), false);

  const { state } = await page.evaluate(async () => (await fetch('state.json')).json());
  const lost = [12, 13, 14].map((n) => ({ ...state, state: 'lost', sentence: `learner lost for ${n} s` }));
  const body = lost.map((data) => `event: state\ndata: ${JSON.stringify(data)}\n\n`).join('');
  const asked = { times: 0 };
  await page.route('**/events', (route) => {
    asked.times += 1;
    return route.fulfill({ contentType: 'text/event-stream', body: asked.times === 1 ? body : '' });
  });
  await page.evaluate(() => {
    window.aloud = [];
    const note = (changes) => changes.forEach((change) => change.addedNodes.forEach((node) => window.aloud.push(node.textContent)));
    new MutationObserver(note).observe(document.querySelector('#aloud'), { childList: true });
  });
  await place.processes.at(-1).kill();
  await until('a further question', () => asked.times > 1);
  const aloud = await page.evaluate(() => window.aloud);
  assert.deepEqual(aloud.filter((sentence) => sentence.startsWith('learner')), ['learner lost']);
});

test('an episode that begins while the picture is paused is drawn once it goes on', async (t) => {
  const place = new Place();
  t.after(() => place.clean());
  assert.equal(await place.start(SHORT).ended, 0);
  const { page } = await chrome.open(await place.start('watch runs/short --http 127.0.0.1:0').page());
  // From here on the page hears what this test tells it, at its next question.
  const [queue, asked] = [[], { times: 0 }];
  await page.route('**/events', (route) => {
    asked.times += 1;
    return route.fulfill({ contentType: 'text/event-stream', body: queue.shift() ?? '' });
  });
  await page.reload();
  const event = (kind, data) => `event: ${kind}\ndata: ${JSON.stringify(data)}\n\n`;
  const begin = (flight) => event('flight', { flight, version: flight, index: 0, view: [0, 0, 1, 1], still: [], gauge: { label: 'gauge' } });
  const step = (flight, gauge) =>
    event('frame', { flight, at: [0.5, 0.5], activity: 'own plan', said: null, reacting: null, pending: null, gauge, shapes: [], end: null });
  const seen = async () => `${await text(page, 'flight-note')}: ${await text(page, 'doing')}`;
  const first = 'version 1, episode 0: own plan \u00b7 gauge 1.00';
  queue.push(begin(1) + step(1, 1));
  await until('the first episode', async () => (await seen()) === first);
  await page.locator('#pause').click();
  queue.push(begin(2) + begin(3) + step(3, 2));
  await until('the next question', () => queue.length === 0);
  const before = asked.times;
  await until('another one', () => asked.times > before);
  assert.equal(await seen(), first, 'it stands still');
  await page.locator('#pause').click();
  assert.match(await seen(), /^version 3, episode 0/);
  queue.push(step(3, 3));
  await until('a step of the newest episode', async () => (await seen()) === 'version 3, episode 0: own plan \u00b7 gauge 3.00');
});

/** Lists texts whose contrast with what is behind them is below 4.5. */
function illegible() {
  const channel = (value) => ((value /= 255) <= 0.03928 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4);
  const luminance = ([r, g, b]) => 0.2126 * channel(r) + 0.7152 * channel(g) + 0.0722 * channel(b);
  const numbers = (colour) => colour.match(/[\d.]+/g).map(Number);
  const behind = (element) => {
    for (let at = element; at; at = at.parentElement) {
      const colour = numbers(getComputedStyle(at).backgroundColor);
      if (colour.length < 4 || colour[3] === 1) return colour;
    }
    return [255, 255, 255];
  };
  const found = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const parent = walker.currentNode.parentElement;
    if (!walker.currentNode.textContent.trim() || !parent.checkVisibility() || parent.closest('noscript')) continue;
    const [a, b] = [luminance(numbers(getComputedStyle(parent).color)), luminance(behind(parent))];
    const contrast = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    if (contrast < 4.5) found.push(`${walker.currentNode.textContent.trim()}: ${contrast.toFixed(2)}`);
  }
  return found;
}
