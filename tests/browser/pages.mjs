// Every page of an empty and of a filled database in a real browser: node pages.mjs EMPTY FILLED TOOLS OUT
import assert from 'node:assert/strict';
import { mkdirSync, readFileSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { Browser } from './chromium.mjs';

const [, , empty, filled, tools, out] = process.argv;
const axe = readFileSync(join(tools, 'node_modules/axe-core/axe.min.js'), 'utf8');
mkdirSync(out, { recursive: true });

const json = async (path, options) => {
  const answer = await fetch(filled + path, options);
  assert.ok(answer.ok, `${path}: ${answer.status} ${await answer.clone().text()}`);
  return answer.json();
};
const post = (path, body) => json(path, { method: 'POST', headers: { 'content-type': 'application/json' }, body: JSON.stringify(body) });

/** What is where in the filled database. */
const places = async () => {
  const studies = (await json('/v1/studies')).items;
  const [first, second] = [studies[0].id, studies[1].id];
  const subject = (await json(`/v1/studies/${first}/subjects`)).items[0].id;
  const trials = (await json(`/v1/subjects/${subject}/trials`)).items.sort((a, b) => a.number - b.number);
  const of = async (query) => (await json(`/v1/analyses?${query}&limit=1`)).items[0].id;
  const pool = await of('kind=ssid&status=succeeded');
  const error = await of('kind=prediction_error&status=succeeded');
  return { first, second, subject, trials, pool, error };
};

const found = await places();
const last = found.trials.at(-1).id;
const nobody = '0199d2f4-7a3c-7bb0-8a41-2f6a7e1c9d10';
const pages = [
  ['empty-home', empty, '/'], ['empty-start', empty, '/analyses/new'], ['empty-queue', empty, '/queue'], ['no-such-study', empty, `/studies/${nobody}`],
  ['no-such-page', empty, '/nowhere'], ['not-an-id', empty, '/trials/7'],
  ['home', filled, '/'], ['queue', filled, '/queue'],
  ['study', filled, `/studies/${found.first}`], ['study-pool', filled, `/studies/${found.first}?estimator=ssid&quantity=norm_feedback&figure=norm_feedback`],
  ['study-two-stimuli', filled, `/studies/${found.second}`],
  ['subject', filled, `/subjects/${found.subject}`], ['trial', filled, `/trials/${last}`],
  ['trial-zoomed', filled, `/trials/${last}?from=20&to=25`],
  ['start', filled, `/analyses/new?kind=ssid&trial=${last}`], ['start-study', filled, `/analyses/new?study=${found.first}`],
  ['analysis-pool', filled, `/analyses/${found.pool}`], ['analysis-error', filled, `/analyses/${found.error}`],
];
const isRefused = (name) => name.startsWith('no');

const browser = new Browser();
const findings = [];
const say = (name, what) => {
  findings.push(`${name}: ${what}`);
  console.error(`${name}: ${what}`);
};

/** Everything that must hold of a page as it stands. */
const judge = async (page, name, origin) => {
  // A page that is not there is told to the console by the browser itself.
  const errors = page.errors.filter((error) => !(isRefused(name) && /status of 4\d\d/.test(error)));
  for (const error of errors) say(name, `console: ${error}`);
  for (const url of page.requests) if (!url.startsWith(origin)) say(name, `asks elsewhere: ${url}`);
  const wide = await page.value('document.documentElement.scrollWidth - innerWidth');
  if (wide > 0) say(name, `scrolls sideways by ${wide} px`);
  if (await page.value("document.querySelectorAll('h1').length") !== 1) say(name, 'has not one h1');
  await page.value(`${axe};0`);
  const violations = await page.value(`axe.run(document, { resultTypes: ['violations'] }).then(({ violations }) => violations.map(
    ({ id, impact, nodes }) => id + ' (' + impact + '): ' + nodes.slice(0, 3).map((node) => node.target + ' ' + (node.any[0]?.message ?? '')).join(' | ')))`);
  for (const violation of violations) say(name, `axe: ${violation}`);
};

for (const width of [1280, 400]) {
  for (const theme of ['light', 'dark']) {
    for (const [name, origin, path] of pages) {
      const page = await browser.page(width, theme);
      await page.go(origin + path);
      const whole = `${name}-${theme}-${width}`;
      await judge(page, whole, origin);
      writeFileSync(join(out, `${whole}.png`), await page.picture());
      await page.close();
    }
  }
}

// ---- a dragged stretch of the signals is looked at, and Back leads to the whole
{
  const page = await browser.page(1280, 'light');
  await page.go(`${filled}/trials/${last}`);
  const [x, y, width] = await page.value("(() => { const b = document.querySelector('.wide .f-plot').getBoundingClientRect(); return [b.x, b.y + b.height / 2, b.width] })()");
  await page.mouse('mousePressed', x + 0.25 * width, y);
  await page.mouse('mouseMoved', x + 0.4 * width, y);
  await page.mouse('mouseMoved', x + 0.5 * width, y);
  await page.mouse('mouseReleased', x + 0.5 * width, y);
  const from = "Number(document.querySelector('.wide svg.fig').dataset.from)";
  await page.until(`${from} > 14 && ${from} < 16`, 'the figure begins at a quarter of a minute');
  const [to, query, links] = await page.value("[Number(document.querySelector('.wide svg.fig').dataset.to), location.search, document.querySelector('[data-trial=before]').search]");
  assert.ok(to > 29 && to < 31, `it ends at ${to}`);
  assert.ok(/from=1[45]/.test(query) && links === query, `${query} ${links}`);
  await page.value('history.back()');
  await page.until(`${from} === 0`, 'Back leads to the whole trial');
  await page.value("document.querySelector('.wide svg.fig').focus()");
  await page.press('+');
  await page.until(`${from} > 10`, 'the key + looks closer');
  assert.deepEqual(page.errors, []);
  await page.close();
}

// ---- the theme button changes colours without loading anything, and the choice is kept
{
  const page = await browser.page(1280, 'light');
  await page.go(`${filled}/`);
  const ground = 'getComputedStyle(document.body).backgroundColor';
  const before = await page.value(ground);
  const requests = page.requests.length;
  await page.value("document.querySelector('[data-theme-button]').click()");
  assert.notEqual(await page.value(ground), before);
  assert.equal(page.requests.length, requests);
  await page.go(`${filled}/queue`);
  assert.equal(await page.value('document.documentElement.dataset.theme'), 'dark');
  await page.go(`${filled}/?theme=light`);
  assert.deepEqual(await page.value('[location.search, document.documentElement.dataset.theme]'), ['', 'light']);
  await page.close();
}

// ---- keys: to the queue, rows, trials before and after; none while typing
{
  const page = await browser.page(1280, 'light');
  await page.go(`${filled}/`);
  await page.press('j');
  await page.press('Enter');
  await page.until("location.pathname.startsWith('/studies/')", 'j and Enter open the first study');
  await page.go(`${filled}/trials/${last}`);
  await page.press('[');
  await page.until(`location.pathname === '/trials/${found.trials.at(-2).id}'`, '[ leads to the trial before');
  await page.until("document.readyState === 'complete' && document.querySelector('.zoom')", 'the trial is there');
  await page.value("document.querySelector('.zoom input').focus()");
  await page.press('t');
  assert.equal(await page.value("document.documentElement.dataset.theme ?? 'system'"), 'system');
  await page.value('document.activeElement.blur()');
  await page.press('?');
  assert.ok(await page.value("document.querySelector('dialog').open"));
  await page.press('Escape');
  await page.press('g');
  await page.press('q');
  await page.until("location.pathname === '/queue'", 'g q leads to the queue');
  await page.close();
}

// ---- Tab reaches the content, every figure in one step
{
  const page = await browser.page(1280, 'light');
  await page.go(`${filled}/studies/${found.first}`);
  const seen = [];
  for (let i = 0; i < 60; i += 1) {
    await page.press('Tab');
    seen.push(await page.value("(() => { const e = document.activeElement; return e.className.baseVal ?? e.className + ' ' + e.textContent.slice(0, 30) })()"));
  }
  assert.ok(seen[0].startsWith('skip'), seen[0]);
  assert.ok(seen.filter((one) => one === 'fig').length >= 2, JSON.stringify(seen));
  await page.close();
}

// ---- a running analysis is followed to its end without loading the page again; another is cancelled
{
  const page = await browser.page(1280, 'light');
  const thinned = (poles, damping, gains) => ({ pool: { name: 'zhang2015_appendix_c', thin: { poles, zeros: poles, damping, gains } } });
  const spec = thinned(12, 6, 3);
  const made = await post('/v1/analyses', { kind: 'ssid', inputs: { trial: last }, spec });
  await page.go(`${filled}/analyses/${made.id}`);
  await page.value('window.mark = 7');
  await page.until("document.querySelector('.status').textContent === 'succeeded'", 'the analysis is followed to its end', 280000);
  await page.until("[...document.querySelectorAll('h2')].some((one) => one.textContent === 'What it found')", 'the result is shown');
  assert.equal(await page.value('window.mark'), 7, 'the page was loaded again');
  await judge(page, 'analysis-followed', filled);
  writeFileSync(join(out, 'analysis-followed.png'), await page.picture());

  const long = await post('/v1/analyses', { kind: 'ssid', inputs: { trial: found.trials[0].id }, spec: thinned(2, 2, 1) });
  await page.go(`${filled}/analyses/${long.id}`);
  await page.until("document.querySelector('.status').textContent === 'running' && document.querySelector('progress')", 'it runs');
  writeFileSync(join(out, 'analysis-running.png'), await page.picture());
  await judge(page, 'analysis-running', filled);
  await page.value("document.querySelector('.heading form button').click()");
  await page.until("document.querySelector('.status')?.textContent === 'cancelled'", 'it is cancelled');
  await page.close();
}

// ---- print: no navigation, light
{
  const page = await browser.page(1280, 'dark');
  await page.send('Emulation.setEmulatedMedia', { media: 'print', features: [{ name: 'prefers-color-scheme', value: 'dark' }] });
  await page.go(`${filled}/studies/${found.first}`);
  const [top, ground] = await page.value("[getComputedStyle(document.querySelector('.top')).display, getComputedStyle(document.body).backgroundColor]");
  assert.deepEqual([top, ground], ['none', 'rgb(255, 255, 255)']);
  writeFileSync(join(out, 'study-print.png'), await page.picture());
  await page.close();
}

// ---- what the first drawing costs the main thread
{
  const page = await browser.page(1280, 'light');
  await page.send('Performance.enable', { timeDomain: 'threadTicks' });
  await page.go(`${filled}/trials/${last}`);
  const { metrics } = await page.send('Performance.getMetrics');
  const of = (name) => metrics.find((metric) => metric.name === name).value;
  const ms = 1000 * (of('ScriptDuration') + of('LayoutDuration') + of('RecalcStyleDuration'));
  console.log(`script, layout and style of a trial's page: ${ms.toFixed(0)} ms of the main thread`);
  assert.ok(ms < 150, `${ms} ms`);
  await page.close();
}

await browser.close();
assert.deepEqual(findings, [], `\n${findings.join('\n')}`);
console.log(`pages: ${pages.length} pages in two widths and two themes, without a fault`);
