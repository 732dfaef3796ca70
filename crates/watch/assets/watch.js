// The live page of a run. It reads a stream of events and draws what they say; it asks for nothing else.
// @ts-check

/** @typedef {{min: (number|null)[], max: (number|null)[]}} Extremes */
/** @typedef {{x: number[], scalars: Record<string, Extremes>}} Series */

/** @param {string} id @returns {HTMLElement} */
const $ = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

/** @param {string} tag @param {string} [text] @param {string} [className] */
function element(tag, text, className) {
  const made = document.createElement(tag);
  if (text !== undefined) made.textContent = text;
  if (className) made.className = className;
  return made;
}

/** Colours by name, read from the style sheet, so that light and dark are decided in one place. */
const colours = {
  /** @type {Record<string, string>} */ known: {},
  /** @param {string} name */
  of(name) {
    this.known[name] ??= getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
    return this.known[name];
  },
};

/** @param {number|null|undefined} value */
function written(value) {
  if (value === null || value === undefined || !Number.isFinite(value)) return '\u2013';
  const size = Math.abs(value);
  if (size >= 1e5) return `${(value / 1e3).toFixed(0)}k`;
  if (size >= 100) return value.toFixed(0);
  if (size >= 1 || size === 0) return value.toFixed(2);
  return size >= 0.001 ? value.toFixed(3) : value.toExponential(1);
}

/** @param {number} seconds */
function duration(seconds) {
  if (seconds < 100) return `${Math.round(seconds)} s`;
  if (seconds < 6000) return `${Math.round(seconds / 60)} min`;
  return seconds < 360000 ? `${(seconds / 3600).toFixed(1)} h` : `${(seconds / 86400).toFixed(1)} d`;
}

/** @param {number} value */
const grouped = (value) => Math.round(value).toLocaleString('en-US');

// ---------------------------------------------------------------------------------------------- curves

/** The charts: a title, and the numbers in it with the colour of their line. */
const CHARTS = [
  { title: 'success', lines: [['episodes/success', 'blue']], range: [0, 1] },
  { title: 'return', lines: [['episodes/return', 'blue']] },
  { title: 'episode length', lines: [['episodes/length', 'blue']] },
  { title: 'entropy', lines: [['train/entropy', 'green']] },
  { title: 'KL', lines: [['train/approx_kl', 'purple']] },
  { title: 'clip share', lines: [['train/clip_fraction', 'purple']] },
  { title: 'explained variance', lines: [['train/explained_variance', 'green']] },
  { title: 'losses', hint: 'value loss; dashed: policy loss', lines: [['train/value_loss', 'orange'], ['train/policy_loss', 'neutral']] },
];
const PLOTTED = [...CHARTS.flatMap((chart) => chart.lines.map(([name]) => name)), 'elapsed'];
/** The most points of a curve. */
const MAX_POINTS = 4000;
/** The shortest time between two drawings, in milliseconds. */
const DRAW_PAUSE = 100;
/** Rows of a table that stands for a curve. */
const TABLE_ROWS = 24;

/** @type {Series} */
const series = { x: [], scalars: {} };
let stride = 1;
let inLast = 0;
let stepsPerUpdate = 1;
/** @type {{update: number, what: string}[]} */
let marks = [];
let overTime = false;
/** @type {{min: number, max: number}|null} */
let zoom = null;
/** @type {{plot: any, shown: HTMLElement, chart: any}[]} */
const plots = [];

/** Takes in the curves from an update on. @param {any} told */
function takeHistory(told) {
  if (told.from === 0) {
    series.x = [];
    for (const name of PLOTTED) series.scalars[name] = { min: [], max: [] };
  } else {
    forgetFrom(told.from);
  }
  stepsPerUpdate = told.steps_per_update || 1;
  const n = series.x.length;
  series.x.push(...told.x);
  for (const name of PLOTTED) {
    const ours = (series.scalars[name] ??= { min: [], max: [] });
    const theirs = told.scalars[name];
    pad(ours, n);
    for (let i = 0; i < told.x.length; i++) {
      ours.min.push(theirs ? theirs.min[i] : null);
      ours.max.push(theirs ? theirs.max[i] : null);
    }
  }
  // Not the distance of two points: updates that were not told leave gaps.
  if (told.from === 0) stride = told.stride || 1;
  inLast = stride;
  marks = told.marks;
  shorten();
  drawSoon();
}

/** @param {Extremes} extremes @param {number} n */
function pad(extremes, n) {
  while (extremes.min.length < n) {
    extremes.min.push(null);
    extremes.max.push(null);
  }
}

/** The newest line of an update counts: points from it on are void. @param {number} update */
function forgetFrom(update) {
  let kept = series.x.length;
  while (kept > 0 && series.x[kept - 1] >= update) kept--;
  series.x.length = kept;
  for (const extremes of Object.values(series.scalars)) {
    extremes.min.length = Math.min(extremes.min.length, kept);
    extremes.max.length = Math.min(extremes.max.length, kept);
  }
}

/** @param {any} told */
function takePoint(told) {
  if (!told.update || (series.x.length && told.update === series.x[series.x.length - 1] && stride === 1)) return;
  if (series.x.length && told.update <= series.x[series.x.length - 1]) {
    forgetFrom(told.update);
    inLast = stride;
  }
  if (inLast >= stride || !series.x.length) {
    series.x.push(told.update);
    inLast = 0;
  }
  inLast++;
  const last = series.x.length - 1;
  series.x[last] = told.update;
  for (const name of PLOTTED) {
    const extremes = (series.scalars[name] ??= { min: [], max: [] });
    pad(extremes, last + 1);
    const value = name === 'elapsed' ? told.elapsed : told.scalars[name];
    if (typeof value !== 'number') continue;
    extremes.min[last] = Math.min(extremes.min[last] ?? value, value);
    extremes.max[last] = Math.max(extremes.max[last] ?? value, value);
  }
  shorten();
  drawSoon();
}

/** Joins neighbours while there are too many points. */
function shorten() {
  while (series.x.length > MAX_POINTS) {
    series.x = series.x.filter((_, i) => i % 2 === 1 || i === series.x.length - 1);
    for (const extremes of Object.values(series.scalars)) {
      extremes.min = pairs(extremes.min, Math.min);
      extremes.max = pairs(extremes.max, Math.max);
    }
    stride *= 2;
  }
}

/** @param {(number|null)[]} values @param {(a: number, b: number) => number} pick */
function pairs(values, pick) {
  const joined = [];
  for (let i = 0; i < values.length; i += 2) {
    const a = values[i];
    const b = i + 1 < values.length ? values[i + 1] : null;
    joined.push(a === null ? b : b === null ? a : pick(a, b));
  }
  return joined;
}

function xValues() {
  if (!overTime) return series.x.map((update) => update * stepsPerUpdate);
  const elapsed = series.scalars.elapsed?.max ?? [];
  let last = 0;
  return series.x.map((_, i) => (last = Math.max(last, elapsed[i] ?? last)));
}

/** @param {number|null} value */
function shownX(value) {
  if (value === null) return '';
  if (overTime) return duration(value);
  return value >= 1e6 ? `${+(value / 1e6).toPrecision(3)}M` : value >= 1e3 ? `${+(value / 1e3).toPrecision(3)}k` : `${value}`;
}

/** What is shown of each point, as line, as number and in the table: the middle of its band. @param {Extremes} extremes */
const middles = ({ min, max }) => max.map((high, i) => (high === null || min[i] === null ? null : (high + min[i]) / 2));

/** @param {any} chart @param {number[]} xs */
function dataOf(chart, xs) {
  /** @type {(number|null)[][]} */
  const data = [xs];
  for (const [name] of chart.lines) {
    const extremes = series.scalars[name] ?? { min: [], max: [] };
    data.push(middles(extremes), extremes.max, extremes.min);
  }
  return data;
}

/** Marks where a learner went on. @param {any} plot */
function drawMarks(plot) {
  const context = plot.ctx;
  context.save();
  context.strokeStyle = colours.of('axis');
  context.setLineDash([4, 4]);
  for (const { update } of marks) {
    const at = series.x.findIndex((x) => x >= update);
    if (at < 0) continue;
    const x = Math.round(plot.valToPos(plot.data[0][at], 'x', true));
    if (x < plot.bbox.left || x > plot.bbox.left + plot.bbox.width) continue;
    context.beginPath();
    context.moveTo(x, plot.bbox.top);
    context.lineTo(x, plot.bbox.top + plot.bbox.height);
    context.stroke();
  }
  context.restore();
}

function makeCharts() {
  const faded = (/** @type {string} */ name) => `color-mix(in srgb, ${colours.of(name)} 30%, transparent)`;
  const axis = { font: '11px system-ui', stroke: () => colours.of('muted'), grid: { stroke: () => colours.of('line'), width: 1 }, ticks: { show: false } };
  for (const chart of CHARTS) {
    const cell = element('div', undefined, 'chart');
    const title = element('h3');
    const shown = element('b', '\u2013');
    if (chart.hint) title.title = chart.hint;
    title.append(element('span', chart.title), shown);
    const place = element('div', undefined, 'plot');
    cell.append(title, place);
    $('charts').append(cell);
    const lines = [];
    const bands = [];
    for (const [i, [, colour]] of chart.lines.entries()) {
      const scale = i === 0 ? 'y' : 'y2';
      const common = { scale, points: { show: false }, spanGaps: true };
      lines.push({ ...common, stroke: () => colours.of(colour), width: 1.5, dash: i ? [4, 3] : undefined });
      lines.push({ ...common, width: 0 }, { ...common, width: 0 });
      if (i === 0) bands.push({ series: [2, 3], fill: () => faded(colour) });
    }
    const range = chart.range;
    const plot = new /** @type {any} */ (window).uPlot({
      width: 200,
      height: 90,
      padding: [5, 8, 0, 0],
      legend: { show: false },
      cursor: { sync: { key: 'curves', setSeries: false }, drag: { x: true, y: false, setScale: false }, points: { size: 5 }, y: false },
      scales: { x: { time: false }, y: range ? { range: () => range } : {}, y2: {} },
      axes: [
        { ...axis, size: 18, gap: 2, space: 55, values: (/** @type {any} */ _, /** @type {number[]} */ values) => values.map(shownX) },
        { ...axis, size: 38, gap: 3, space: 24, values: (/** @type {any} */ _, /** @type {number[]} */ values) => values.map((v) => `${+v.toPrecision(3)}`) },
      ],
      series: [{}, ...lines],
      bands,
      hooks: {
        draw: [drawMarks],
        setCursor: [(/** @type {any} */ u) => showValue(u)],
        setSelect: [(/** @type {any} */ u) => {
          if (u.select.width > 3) setZoom({ min: u.posToVal(u.select.left, 'x'), max: u.posToVal(u.select.left + u.select.width, 'x') });
          u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
        }],
      },
    }, [[]], place);
    plot.over.addEventListener('dblclick', () => setZoom(null));
    plots.push({ plot, shown, chart });
    new ResizeObserver(() => resize(plot, place)).observe(place);
  }
}

/** @param {any} plot @param {HTMLElement} place */
function resize(plot, place) {
  const { clientWidth: width, clientHeight: height } = place;
  if (width > 40 && height > 30) plot.setSize({ width, height });
}

/** Writes the value under the cursor, or the newest. @param {any} plot */
function showValue(plot) {
  const found = plots.find((it) => it.plot === plot);
  if (!found) return;
  const at = plot.cursor.idx ?? plot.data[0].length - 1;
  const values = found.chart.lines.map((/** @type {any} */ _, /** @type {number} */ i) => written(plot.data[1 + 3 * i]?.[at]));
  found.shown.textContent = values.join(', ');
}

/** @param {{min: number, max: number}|null} wanted */
function setZoom(wanted) {
  zoom = wanted;
  $('unzoom').hidden = zoom === null;
  $('curves-hint').hidden = zoom !== null;
  drawCharts();
}

function drawCharts() {
  const xs = xValues();
  const whole = { min: xs[0] ?? 0, max: xs.length > 1 ? xs[xs.length - 1] : (xs[0] ?? 0) + 1 };
  for (const { plot, chart } of plots) {
    plot.batch(() => {
      plot.setData(dataOf(chart, xs), false);
      plot.setScale('x', zoom ?? whole);
    });
    showValue(plot);
  }
  if (!$('curves-text').hidden) $('curves-text').replaceChildren(curvesTable(xs));
}

/** @param {number[]} xs */
function curvesTable(xs) {
  const every = Math.max(1, Math.ceil(xs.length / TABLE_ROWS));
  const rows = xs.map((_, i) => i).filter((i) => i === xs.length - 1 || i % every === 0);
  const columns = CHARTS.flatMap((chart) => chart.lines.map(([name]) => name));
  const shown = columns.map((name) => middles(series.scalars[name] ?? { min: [], max: [] }));
  return table(
    [overTime ? 'time' : 'steps', ...columns.map((name) => name.split('/')[1].replaceAll('_', ' '))],
    rows.map((i) => [overTime ? duration(xs[i]) : grouped(xs[i]), ...shown.map((values) => written(values[i]))]),
  );
}

/** @param {string} tag @param {HTMLElement[]} inside */
function filled(tag, inside) {
  const made = element(tag);
  made.append(...inside);
  return made;
}

/** @param {string[]} head @param {string[][]} rows */
function table(head, rows) {
  const top = filled('tr', head.map((text) => Object.assign(element('th', text), { scope: 'col' })));
  const lines = rows.map((row) => filled('tr', row.map((text) => element('td', text))));
  return filled('table', [filled('thead', [top]), filled('tbody', lines)]);
}

let [drawing, drawnAt] = [0, 0];
/** Draws the curves at most ten times a second, and not while nobody sees them. */
function drawSoon() {
  if (drawing || document.hidden) return;
  const wait = Math.max(0, DRAW_PAUSE - (performance.now() - drawnAt));
  drawing = window.setTimeout(() => {
    drawing = 0;
    drawnAt = performance.now();
    drawCharts();
  }, wait);
}

/** @param {KeyboardEvent} event */
function onChartKey(event) {
  const xs = xValues();
  if (xs.length < 2) return;
  const whole = { min: xs[0], max: xs[xs.length - 1] };
  const { min, max } = zoom ?? whole;
  const [middle, half] = [(min + max) / 2, (max - min) / 2];
  const moved = (/** @type {number} */ by) => {
    const shift = Math.max(whole.min - min, Math.min(whole.max - max, by));
    return { min: min + shift, max: max + shift };
  };
  /** @type {Record<string, () => void>} */
  const actions = {
    '+': () => setZoom({ min: middle - half / 2, max: middle + half / 2 }),
    '-': () => setZoom(half * 4 >= whole.max - whole.min ? null : { min: Math.max(whole.min, middle - half * 2), max: Math.min(whole.max, middle + half * 2) }),
    ArrowLeft: () => setZoom(moved(-half / 2)),
    ArrowRight: () => setZoom(moved(half / 2)),
    0: () => setZoom(null),
  };
  const action = actions[event.key === '=' ? '+' : event.key === 'Escape' ? '0' : event.key];
  // The browser has keys of its own, such as Alt and an arrow.
  if (action && !event.ctrlKey && !event.metaKey && !event.altKey && (zoom || !event.key.startsWith('Arrow'))) {
    event.preventDefault();
    action();
  }
}

// ---------------------------------------------------------------------------------------------- head line

let complete = 0;
/** @param {any} told */
function takeState(told) {
  document.title = `${told.run}: ${told.sentence}`;
  $('run').textContent = told.run;
  $('domain').textContent = told.domain ?? '';
  setState(told.state, told.sentence);
  complete = told.total_updates ? told.update / told.total_updates : 0;
  /** @type {HTMLProgressElement} */ ($('progress')).value = complete;
  $('updates').textContent = told.total_updates ? `${grouped(told.update)} of ${grouped(told.total_updates)} updates` : '';
  const left = told.seconds_left;
  $('left').textContent = told.state === 'finished' ? 'none' : left === null ? '\u2013' : duration(left);
  $('speed').textContent = told.steps_per_second === null ? '\u2013' : grouped(told.steps_per_second);
  const knows = told.success !== null;
  $('success-name').textContent = knows ? 'success (100)' : 'return (100)';
  $('success').textContent = knows ? told.success.toFixed(2) : written(told.return);
  $('version').textContent = grouped(told.version);
  const missed = [];
  if (told.missed) missed.push(`${grouped(told.missed)} messages missed`);
  if (told.skipped) missed.push(`${told.skipped} unreadable line${told.skipped === 1 ? '' : 's'} of metrics left out`);
  $('missed').textContent = missed.join('; ');
}

/** @param {string} name @param {string} sentence */
function setState(name, sentence) {
  [$('state').className, $('state').textContent] = [`state ${name}`, sentence];
  // What has not changed must not be read aloud again, nor every second that passes.
  const aloud = sentence.replace(/ for \d+ s$/, '');
  if ($('aloud').textContent !== aloud) $('aloud').textContent = aloud;
}

// ---------------------------------------------------------------------------------------------- update

/** The highest staleness that the picture has room for; the text has all. */
const MAX_STALENESS = 64;
let update = /** @type {any} */ (null);
/** @param {any} told */
function takeUpdate(told) {
  update = told;
  takePoint(told);
  if (told.made) document.documentElement.dataset.age = String(Math.round(Date.now() - told.made * 1000));
  document.documentElement.dataset.update = String(told.update);
  drawHistogram();
  showPhases();
  showBooks();
}

/** @param {HTMLCanvasElement} canvas */
function prepared(canvas) {
  const scale = window.devicePixelRatio || 1;
  const { clientWidth: width, clientHeight: height } = canvas;
  if (canvas.width !== Math.round(width * scale) || canvas.height !== Math.round(height * scale)) {
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(height * scale);
  }
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext('2d'));
  context.setTransform(scale, 0, 0, scale, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}

/** @param {Record<string, number>} counts */
function shares(counts) {
  const sum = Object.values(counts).reduce((a, b) => a + b, 0);
  return new Map(Object.entries(counts).map(([staleness, n]) => [Number(staleness), n / sum]));
}

function drawHistogram() {
  if (!update || document.hidden) return;
  const { context, width, height } = prepared(/** @type {HTMLCanvasElement} */ ($('histogram')));
  const [now, before] = [shares(update.staleness), shares(update.staleness_100)];
  const last = Math.min(MAX_STALENESS, Math.max(3, ...now.keys(), ...before.keys()));
  const slot = width / (last + 1);
  const floor = height - 16;
  Object.assign(context, { font: '11px system-ui', textAlign: 'center' });
  for (let staleness = 0; staleness <= last; staleness++) {
    const bar = (/** @type {number} */ share, /** @type {string} */ colour, /** @type {number} */ from, /** @type {number} */ part) => {
      context.fillStyle = colours.of(colour);
      const tall = share > 0 ? Math.max(1, share * (floor - 14)) : 0;
      context.fillRect(staleness * slot + from * slot, floor - tall, part * slot, tall);
    };
    bar(before.get(staleness) ?? 0, 'axis', 0.5, 0.36);
    bar(now.get(staleness) ?? 0, 'blue', 0.12, 0.36);
    context.fillStyle = colours.of('muted');
    if (last < 12 || staleness % Math.ceil(last / 8) === 0) context.fillText(String(staleness), (staleness + 0.5) * slot, height - 3);
    const share = now.get(staleness) ?? 0;
    if (share > 0.005 && slot > 24) context.fillText(`${Math.round(share * 100)}%`, (staleness + 0.3) * slot, floor - share * (floor - 14) - 3);
  }
  context.fillStyle = colours.of('axis');
  context.fillRect(0, floor, width, 1);
  // Only where the schedule is asynchronous do rollouts of an update differ in staleness.
  const clipped = Object.entries(update.clip_by_staleness ?? {}).map(([staleness, share]) => [staleness, `${(share * 100).toFixed(1)} %`]);
  $('clip-shares').textContent = clipped.length ? `clipped: ${clipped.map((pair) => pair.join(': ')).join(', ')}` : '';
  if (!$('staleness-text').hidden) {
    const rows = [...new Set([...now.keys(), ...before.keys()])].sort((a, b) => a - b);
    const cells = [update.staleness, update.staleness_100, ...(clipped.length ? [Object.fromEntries(clipped)] : [])];
    $('staleness-text').replaceChildren(table(['versions', 'last update', 'last 100', 'clipped'].slice(0, cells.length + 1), rows.map((key) => [String(key), ...cells.map((of) => String(of[key] ?? 0))])));
  }
}

const LEARNER_PARTS = [['wait', 'orange', 'waits'], ['train', 'blue', 'trains'], ['rest', 'axis', 'rest']];
const ACTOR_PARTS = [['simulate', 'green', 'simulates'], ['infer', 'sky', 'infers'], ['encode', 'purple', 'encodes'], ['publish', 'vermilion', 'publishes'], ['wait', 'orange', 'waits']];

/** @param {string[][]} parts @param {Record<string, number>} values @param {string} [className] */
function stack(parts, values, className = 'stack') {
  const bar = element('div', undefined, className);
  for (const [name, colour] of parts) {
    const part = element('i');
    part.style.width = `${(values[name] ?? 0) * 100}%`;
    part.style.background = colours.of(colour);
    bar.append(part);
  }
  bar.setAttribute('role', 'img');
  bar.setAttribute('aria-label', parts.map(([name, , label]) => `${label} ${Math.round((values[name] ?? 0) * 100)} %`).join(', '));
  return bar;
}

/** @param {string} title @param {string[][]} parts @param {Record<string, number>} values */
function phaseBlock(title, parts, values) {
  const keys = element('div', undefined, 'keys');
  for (const [name, colour, label] of parts) {
    const key = element('span', `${label} ${Math.round((values[name] ?? 0) * 100)} %`);
    const swatch = element('i', undefined, 'swatch');
    swatch.style.background = colours.of(colour);
    key.prepend(swatch);
    keys.append(key);
  }
  return [element('div', title, 'muted'), stack(parts, values), keys];
}

function showPhases() {
  const blocks = [];
  if (update?.phases) blocks.push(...phaseBlock('learner, last minute', LEARNER_PARTS, update.phases));
  const here = actors.filter((actor) => actor.shares && actor.gone_s === null);
  if (here.length) {
    /** @type {Record<string, number>} */
    const mean = {};
    for (const [name] of ACTOR_PARTS) mean[name] = here.reduce((sum, actor) => sum + actor.shares[name], 0) / here.length;
    blocks.push(...phaseBlock(here.length === 1 ? 'actor' : `mean of ${here.length} actors`, ACTOR_PARTS, mean));
  }
  $('phase-bars').replaceChildren(...blocks);
  $('phase-sentence').textContent = update?.phases?.sentence ?? '';
}

/** @type {Record<string, string>} */
const FATES = {
  trained: 'trained on', dropped_stale: 'too stale', refused: 'refused', superseded: 'superseded',
  rolled_back: 'rolled back', on_their_way: 'on their way', unused_at_end: 'unused at the end',
};

function showBooks() {
  const books = update?.books;
  if (!books) return ['books-rows', 'balance', 'refusals'].forEach((id) => $(id).replaceChildren());
  const fate = (/** @type {any} */ entry, /** @type {number} */ i) => [FATES[entry[0]] ?? entry[0], entry[1], i ? '+' : '='];
  const rows = [['published', books.published, ''], ...books.entries.map(fate)];
  $('books-rows').replaceChildren(...rows.map(([label, n, sign]) => filled('tr', [element('td', `${sign} ${label}`.trim()), element('td', grouped(n))])));
  $('balance').textContent = books.balanced ? 'balanced' : 'NOT balanced';
  $('balance').className = books.balanced ? 'good' : 'bad';
  const refusals = Object.entries(update.refusals).map(([cause, n]) => `${cause.replaceAll('_', ' ')} ${n}`);
  const notes = [];
  if (refusals.length) notes.push(`refused messages: ${refusals.join(', ')}`);
  if (books.duplicates) notes.push(`${grouped(books.duplicates)} duplicates`);
  if (books.steps_redone) notes.push(`${grouped(books.steps_redone)} steps made again`);
  $('refusals').textContent = notes.join('; ');
}

// ---------------------------------------------------------------------------------------------- actors

/** @type {any[]} */
let actors = [];
/** @type {[string, (actor: any) => any, (value: any, actor: any) => string|HTMLElement][]} */
const COLUMNS = [
  ['actor', (it) => it.id, (id) => id],
  ['envs', (it) => it.envs, String],
  ['steps/s', (it) => it.steps_per_second, (n) => (n === null ? '\u2013' : grouped(n))],
  ['iteration', (it) => it.iteration, (n) => (n === null ? '\u2013' : grouped(n))],
  ['lag', (it) => it.lag, (n) => (n === null ? '\u2013' : String(n))],
  ['credit', (it) => it.credit.used, (n, it) => `${n ?? '\u2013'}/${it.credit.window ?? '\u2013'}`],
  ['refused', (it) => it.refused, String],
  ['seen', (it) => it.gone_s ?? it.silent_s, (_, it) => (it.gone_s === null ? `${it.silent_s.toFixed(0)} s` : 'gone')],
  ['time', (it) => it.shares?.wait, (_, it) => (it.shares ? stack(ACTOR_PARTS, it.shares, 'stack small') : '')],
];
let sorted = { column: 0, up: true };

function makeActorsHead() {
  for (const [i, [title]] of COLUMNS.entries()) {
    const cell = element('th');
    cell.setAttribute('scope', 'col');
    const button = /** @type {HTMLButtonElement} */ (element('button', title));
    button.type = 'button';
    button.addEventListener('click', () => {
      sorted = { column: i, up: sorted.column === i ? !sorted.up : true };
      showActors();
    });
    cell.append(button);
    $('actors-head').append(cell);
  }
}

function showActors() {
  const [, value] = COLUMNS[sorted.column];
  const order = (/** @type {any} */ a, /** @type {any} */ b) => {
    const [x, y] = [value(a) ?? -1, value(b) ?? -1];
    const way = typeof x === 'string' ? x.localeCompare(y, 'en', { numeric: true }) : x - y;
    return sorted.up ? way : -way;
  };
  for (const [i, cell] of [...$('actors-head').children].entries()) {
    if (i === sorted.column) cell.setAttribute('aria-sort', sorted.up ? 'ascending' : 'descending');
    else cell.removeAttribute('aria-sort');
  }
  $('actors-rows').replaceChildren(...[...actors].sort(order).map((actor) => {
    const row = element('tr', undefined, actor.gone_s !== null ? 'gone' : actor.is_silent ? 'silent' : '');
    row.dataset.actor = actor.id;
    for (const [, of, show] of COLUMNS) {
      const cell = element('td');
      cell.append(show(of(actor), actor));
      row.append(cell);
    }
    return row;
  }));
  const here = actors.filter((actor) => actor.gone_s === null).length;
  $('actors-count').textContent = here === actors.length ? `${here}` : `${here}, and ${actors.length - here} gone`;
}

// ---------------------------------------------------------------------------------------------- log

/** @param {any[]} lines */
function takeLog(lines) {
  for (const line of lines) {
    const item = element('li', undefined, line.level);
    item.dataset.number = line.number;
    const time = /** @type {HTMLTimeElement} */ (element('time', new Date(line.at * 1000).toTimeString().slice(0, 8)));
    time.dateTime = new Date(line.at * 1000).toISOString();
    item.append(time, line.text);
    const newest = Number(/** @type {HTMLElement|null} */ ($('log-lines').firstElementChild)?.dataset.number ?? 0);
    if (line.number <= newest) continue;
    const first = $('log-lines').firstElementChild;
    // Of checkpoints in a row the newest is enough.
    if (line.text.startsWith('checkpoint') && first?.textContent?.slice(8).startsWith('checkpoint')) first.remove();
    $('log-lines').prepend(item);
  }
  while ($('log-lines').children.length > 200) $('log-lines').lastElementChild?.remove();
}

// ---------------------------------------------------------------------------------------------- playthrough

/** The last one is the newest episode that began while the picture was paused. @type {any[]} */
let [flight, frame, waiting] = [null, null, null];
/** Where the listener has been, with what they did on the way. @type {{at: number[], colour: string}[]} */
let trail = [];
let paused = false;
let zones = true;
/** @type {Record<string, string>} */
const ACTIVITIES = { 'own plan': 'neutral', 'hearing, not yet understood': 'orange', 'reaction delay': 'purple', 'follows through': 'blue' };
/** The least and the greatest height of the picture, as a share of its width. */
const RATIOS = [0.25, 0.75];

/** @param {any} told */
function takeFlight(told) {
  waiting = paused ? told : null;
  if (paused) return;
  [flight, frame, trail] = [told, null, []];
  $('flight-note').textContent = told.problem ? '' : `version ${told.version}, episode ${told.index}`;
  if (!told.problem) return;
  for (const id of ['heard', 'doing']) $(id).textContent = '';
  $('unheard').textContent = told.problem;
  drawStage();
}

/** @param {any} told */
function takeFrame(told) {
  if (paused || !flight || flight.flight !== told.flight) return;
  frame = told;
  trail.push({ at: told.at, colour: ACTIVITIES[told.activity] ?? 'neutral' });
  const said = told.said;
  const words = said?.words ?? (said ? `[${said.topic} ${said.heard}/${said.l}]` : '');
  $('heard').textContent = words;
  $('unheard').textContent = said?.sentence?.startsWith(words) ? said.sentence.slice(words.length) : '';
  const doing = [];
  if (said) doing.push(`${said.topic}: k ${said.k}, l ${said.l}${said.heard >= said.k ? ', understood' : ''}`);
  if (told.reacting) doing.push(`follows ${told.reacting}`);
  else if (told.pending) doing.push(`about to react: ${told.pending}`);
  else if (!said) doing.push('own plan');
  if (flight.gauge.label) doing.push(`${flight.gauge.label} ${written(told.gauge)}`);
  $('doing').textContent = told.end ? `${told.end.title.replace('newest: ', '')}; return ${told.end.return.toFixed(1)}` : doing.join(' \u00b7 ');
  $('doing').className = told.end ? (told.end.success === false ? 'bad' : 'good') : 'muted';
  if (!document.hidden) drawStage();
}

/** @type {Record<string, [string, number, boolean]>} Ink, opacity and whether it is outlined, by what a shape means. */
const FILLS = {
  ground: ['ground', 1, false], goal: ['green', 0.3, true], danger: ['vermilion', 0.16, true],
  mistaken: ['vermilion', 0.16, true], own: ['text', 1, false], other: ['muted', 0.6, false], hint: ['sky', 0.4, false],
};
/** @type {Record<string, [string, number]>} Ink and width of lines. */
const STROKES = {
  ground: ['ground', 2.5], goal: ['green', 5], danger: ['vermilion', 1.5], mistaken: ['vermilion', 1.5],
  own: ['text', 2], other: ['muted', 3], hint: ['line', 1],
};

function drawStage() {
  const canvas = /** @type {HTMLCanvasElement} */ ($('stage'));
  const { context, width, height } = prepared(canvas);
  if (!flight || flight.problem || !frame) return;
  const [x0, y0, x1, y1] = frame.view ?? flight.view;
  const ratio = Math.min(RATIOS[1], Math.max(RATIOS[0], (y1 - y0) / (x1 - x0)));
  const wide = Math.min(width, height / ratio);
  const tall = wide * ratio;
  const [left, top] = [(width - wide) / 2, (height - tall) / 2];
  const at = (/** @type {number} */ x, /** @type {number} */ y) => /** @type {[number, number]} */ ([left + ((x - x0) / (x1 - x0)) * wide, top + tall - ((y - y0) / (y1 - y0)) * tall]);
  context.save();
  context.beginPath();
  context.rect(left, top, wide, tall);
  context.clip();
  context.fillStyle = colours.of('paper');
  context.fillRect(left, top, wide, tall);
  for (const shape of [...flight.still, ...frame.shapes]) drawShape(context, shape, at);
  drawTrail(context, at);
  // The listener is never hidden by the path.
  for (const shape of frame.shapes) if (shape[1] === 'own') drawShape(context, shape, at);
  context.restore();
}

/** @param {CanvasRenderingContext2D} context @param {(x: number, y: number) => [number, number]} at */
function drawTrail(context, at) {
  for (let i = 1; i < trail.length; i++) {
    context.strokeStyle = colours.of(trail[i].colour);
    context.lineWidth = trail[i].colour === 'neutral' ? 1.5 : 3;
    context.beginPath();
    context.moveTo(...at(trail[i - 1].at[0], trail[i - 1].at[1]));
    context.lineTo(...at(trail[i].at[0], trail[i].at[1]));
    context.stroke();
  }
}

/** @param {CanvasRenderingContext2D} context @param {any[]} shape @param {(x: number, y: number) => [number, number]} at */
function drawShape(context, [kind, tone, numbers, text], at) {
  if (!zones && (tone === 'danger' || tone === 'mistaken')) return;
  if (kind === 'text') {
    const [x, y] = at(numbers[0], numbers[1]);
    context.font = '11px system-ui';
    context.textAlign = 'center';
    context.strokeStyle = colours.of('paper');
    context.lineWidth = 3;
    context.strokeText(text, x, y + 4);
    context.fillStyle = colours.of('text');
    context.fillText(text, x, y + 4);
    return;
  }
  context.beginPath();
  const points = kind === 'rect' ? [numbers[0], numbers[1], numbers[2], numbers[1], numbers[2], numbers[3], numbers[0], numbers[3]] : numbers;
  for (let i = 0; i < points.length; i += 2) context.lineTo(...at(points[i], points[i + 1]));
  context.setLineDash([]);
  if (kind === 'line') {
    const [ink, width] = STROKES[tone] ?? STROKES.other;
    context.strokeStyle = colours.of(ink);
    context.lineWidth = width;
    context.stroke();
    return;
  }
  const [ink, opacity, outlined] = FILLS[tone] ?? FILLS.other;
  context.closePath();
  context.globalAlpha = opacity;
  context.fillStyle = colours.of(ink);
  context.fill();
  context.globalAlpha = 1;
  if (outlined) {
    context.strokeStyle = colours.of(ink);
    context.lineWidth = 1.2;
    if (tone !== 'goal') context.setLineDash([5, 4]);
    context.stroke();
    context.setLineDash([]);
  }
}

// ---------------------------------------------------------------------------------------------- events

/** When the watcher started: another one has another log and other episodes. */
let watcher = 0;
/** @param {any} told */
function takeAbout(told) {
  if (told.watcher === watcher) return;
  $('log-lines').replaceChildren();
  [watcher, flight, frame, trail, waiting] = [told.watcher, null, null, [], null];
  setZoom(null);
  for (const id of ['flight-note', 'heard', 'unheard', 'doing']) $(id).textContent = '';
  drawStage();
}

/** @type {Record<string, (told: any) => void>} */
const HANDLERS = {
  about: takeAbout,
  history: takeHistory,
  update: takeUpdate,
  state: takeState,
  actors: (told) => {
    actors = told;
    showActors();
    showPhases();
  },
  flight: takeFlight,
  frame: takeFrame,
  log: takeLog,
  bye: () => void (ended = true),
};
let lastId = '';
/** The watcher has said goodbye. */
let ended = false;

/** @param {string} block */
function takeEvent(block) {
  let [kind, data] = ['', ''];
  for (const line of block.split('\n')) {
    if (line.startsWith('event: ')) kind = line.slice(7);
    else if (line.startsWith('data: ')) data += line.slice(6);
    else if (line.startsWith('id: ')) lastId = line.slice(4);
  }
  if (kind in HANDLERS) HANDLERS[kind](JSON.parse(data));
}

/** A watcher tells how the run is once a second. One that is silent for so long is lost; in milliseconds. */
const PATIENCE = 10_000;

/** Reads the stream until it ends. `EventSource` would send no headers, and so no token. */
async function listen() {
  const control = new AbortController();
  let timer = 0;
  const heard = () => {
    window.clearTimeout(timer);
    timer = window.setTimeout(() => control.abort(), PATIENCE);
  };
  heard();
  /** @type {Record<string, string>} */
  const headers = lastId ? { 'Last-Event-ID': lastId } : {};
  const token = new URLSearchParams(location.hash.slice(1)).get('token');
  if (token) headers.Authorization = `Bearer ${token}`;
  const answer = await fetch('events', { headers, cache: 'no-store', signal: control.signal });
  if (!answer.ok || !answer.body) throw new Error((await answer.text()).trim());
  const [reader, decoder] = [answer.body.getReader(), new TextDecoder()];
  let text = '';
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    heard();
    text += decoder.decode(value, { stream: true });
    const blocks = text.split('\n\n');
    text = blocks.pop() ?? '';
    blocks.forEach(takeEvent);
  }
}

async function follow() {
  for (;;) {
    let reason = 'the connection to the watcher is lost; trying again';
    try {
      await listen();
      if (ended) reason = complete >= 1 ? 'finished; the watcher has ended' : 'the watcher has ended; trying again';
    } catch (error) {
      if (error instanceof DOMException) reason = 'the watcher is silent; trying again';
      else if (error instanceof Error && !(error instanceof TypeError)) reason = error.message;
    }
    if (ended && complete >= 1) return setState('finished', reason);
    setState('offline', reason);
    ended = false;
    await new Promise((resolve) => setTimeout(resolve, 2000));
  }
}

// ---------------------------------------------------------------------------------------------- page

function redrawAll() {
  colours.known = {};
  drawCharts();
  for (const { plot } of plots) plot.redraw(false);
  drawHistogram();
  drawStage();
  showPhases();
  showActors();
}

for (const button of /** @type {NodeListOf<HTMLButtonElement>} */ (document.querySelectorAll('button[data-text]'))) {
  const name = /** @type {string} */ (button.dataset.text);
  const picture = name === 'curves' ? 'charts' : 'histogram';
  button.addEventListener('click', () => {
    const isText = $(`${name}-text`).hidden;
    $(`${name}-text`).hidden = !isText;
    $(picture).hidden = isText;
    button.setAttribute('aria-expanded', String(isText));
    button.textContent = isText ? 'as picture' : 'as text';
    redrawAll();
  });
}
$('axis').addEventListener('click', () => {
  overTime = !overTime;
  $('axis').textContent = overTime ? 'over steps' : 'over time';
  setZoom(null);
});
$('unzoom').addEventListener('click', () => setZoom(null));
$('charts').addEventListener('keydown', onChartKey);
$('zones').addEventListener('click', () => {
  zones = !zones;
  $('zones').setAttribute('aria-pressed', String(zones));
  drawStage();
});
$('pause').addEventListener('click', () => {
  paused = !paused;
  $('pause').setAttribute('aria-pressed', String(paused));
  // What happened meanwhile was not drawn.
  if (!paused) trail = [];
  if (!paused && waiting) takeFlight(waiting);
});
document.addEventListener('visibilitychange', () => document.hidden || redrawAll());
matchMedia('(prefers-color-scheme: dark)').addEventListener('change', redrawAll);
new ResizeObserver(() => {
  drawHistogram();
  drawStage();
}).observe($('stage'));

makeCharts();
makeActorsHead();
follow();
