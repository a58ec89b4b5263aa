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

/** How many trials the first study has. */
const stored = async () => {
  const subjects = (await json(`/v1/studies/${found.first}/subjects`)).items;
  const lists = await Promise.all(subjects.map(({ id }) => json(`/v1/subjects/${id}/trials?limit=200`)));
  return lists.reduce((sum, { items }) => sum + items.length, 0);
};

const found = await places();
const last = found.trials.at(-1).id;
const nobody = '0199d2f4-7a3c-7bb0-8a41-2f6a7e1c9d10';
const pages = [
  ['empty-home', empty, '/'], ['empty-start', empty, '/analyses/new'], ['empty-queue', empty, '/queue'], ['no-such-study', empty, `/studies/${nobody}`],
  ['no-such-page', empty, '/nowhere'], ['not-an-id', empty, '/trials/7'],
  ['home', filled, '/'], ['queue', filled, '/queue'],
  ['study', filled, `/studies/${found.first}`], ['study-pool', filled, `/studies/${found.first}?estimator=ssid&quantity=norm_feedback&figure=norm_feedback`],
  ['study-two-stimuli', filled, `/studies/${found.second}`], ['study-practice', filled, `/studies/${found.first}?figure=bode_practice`],
  ['study-plants', filled, `/studies/${found.first}?figure=plants`], ['study-nothing', filled, `/studies/${found.first}?figure=divergent`],
  ['subject', filled, `/subjects/${found.subject}`], ['trial', filled, `/trials/${last}`],
  ['trial-zoomed', filled, `/trials/${last}?from=20&to=25`],
  ['start', filled, `/analyses/new?kind=ssid&trial=${last}`], ['start-study', filled, `/analyses/new?study=${found.first}`],
  ['compare-analyses', filled, `/compare?a=${found.pool}&b=${found.error}`], ['compare', filled, `/compare?study=${found.first}&curve=trials`], ['report', filled, `/studies/${found.first}/report`],
  ['excitation', filled, '/excitation'], ['excitation-multisine', filled, '/excitation?kind=multisine'], ['excitation-wrong', empty, '/excitation?order=1'], ['excitation-limits', filled, '/excitation?position=0.8&velocity=100&acceleration=100'],
  ['upload', filled, '/upload'], ['upload-study', filled, `/upload?study=${found.first}`], ['empty-upload', empty, '/upload'],
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

// ---- under the pointer, and by keyboard, every series says its value; the same numbers stand in a table
{
  const page = await browser.page(1280, 'light');
  await page.go(`${filled}/trials/${last}`);
  const [x, y, width] = await page.value("(() => { const b = document.querySelector('.wide .f-plot').getBoundingClientRect(); return [b.x, b.y + b.height / 2, b.width] })()");
  const box = "document.querySelector('.figure[data-name=signals]')";
  const text = `${box}.querySelector('.readout')?.textContent ?? ''`;
  await page.mouse('mouseMoved', x + 0.5 * width, y, { buttons: 0 });
  await page.until(`/^time 30(\\.\\d+)? s: r .*; y .*; u .*; e /.test(${text})`, 'the pointer reads the middle of the minute');
  const drawn = await json(`/v1/trials/${last}/figures/signals?format=json&theme=page&w=760`);
  const [, at] = (await page.value(text)).match(/^time ([\d.]+) s/);
  const series = drawn.panels[0].series[1];
  const near = series.x.reduce((best, value, i) => (Math.abs(value - at) < Math.abs(series.x[best] - at) ? i : best), 0);
  const said = Number((await page.value(text)).match(/; y ([−\d.e-]+);/)[1].replace('−', '-'));
  assert.ok(Math.abs(said - series.y[near]) < 0.05 * (1 + Math.abs(series.y[near])), `${said} ${series.y[near]}`);
  assert.equal(await page.value(`${box}.querySelectorAll('.wide .crosshair').length`), 3);
  await page.mouse('mouseMoved', 4, 4, { buttons: 0 });
  await page.until(`(${text}) === '' && ${box}.querySelectorAll('.crosshair').length === 0`, 'it is hushed');
  await page.value(`${box}.querySelector('.wide svg.fig').focus()`);
  await page.press('Enter');
  await page.until(`/^time 0 s/.test(${text})`, 'Enter reads the first value');
  await page.press('ArrowRight');
  await page.until(`/^time 0\\.\\d+ s/.test(${text})`, 'the arrow goes to the next');
  const stays = await page.value("Number(document.querySelector('.wide svg.fig').dataset.from)");
  assert.equal(stays, 0, 'while it reads, arrows do not move the view');
  await page.press('End');
  await page.until(`/^time 60 s/.test(${text})`, 'End reads the last value');
  await page.press('Escape');
  await page.until(`(${text}) === ''`, 'Escape ends it');
  await page.value(`${box}.querySelector('details.numbers').open = true`);
  await page.until(`${box}.querySelectorAll('details.numbers tbody tr').length > 100`, 'the numbers are a table');
  const row = await page.value(`[...${box}.querySelectorAll('details.numbers tbody tr')[0].cells].map((cell) => cell.textContent)`);
  assert.deepEqual(row.slice(1, 4), ['r', String(drawn.panels[0].series[0].x[0]), String(drawn.panels[0].series[0].y[0])]);
  await judge(page, 'trial-numbers', filled);
  writeFileSync(join(out, 'trial-numbers.png'), await page.picture());
  // Of people: who, which trial, what, and how far it may be used.
  await page.go(`${filled}/studies/${found.first}`);
  await page.value("document.querySelector('.wide svg[data-figure=norm_feedforward_plant_minus_one]').focus()");
  await page.press('Enter');
  await page.until("/ · trial \\d+ · .* · (ok|read the warnings|do not use)/.test(document.querySelector('.readout')?.textContent)", 'marks say what they are');
  writeFileSync(join(out, 'study-reading.png'), await page.picture());
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

// ---- files are dropped, one of them bad; what was understood is mended, stored, identified
{
  const rows = (head, step) => {
    const lines = [head];
    for (let i = 0; i < 400; i += 1) {
      const t = i * 0.05;
      lines.push([step * i, Math.sin(t), 0.4 * Math.cos(1.3 * t + step), Math.sin(t - 0.2)].map((x) => x.toFixed(6)).join(','));
    }
    return lines.join('\n');
  };
  const files = { 'MP01_t51.csv': rows('t,r,u,y', 0.05), 'MP02 trial 52.csv': rows('Clock,Target,Stick,Cursor', 50), 'photo.csv': '\u0000\u0001<script>alert(1)</script>' };
  const paths = Object.entries(files).map(([name, text]) => { const path = join(out, name); writeFileSync(path, text); return path; });
  const page = await browser.page(1280, 'light');
  await page.go(`${filled}/upload?study=${found.first}`);
  const [x, y] = await page.value("(() => { const b = document.querySelector('[data-drop]').getBoundingClientRect(); return [b.x + b.width / 2, b.y + b.height / 2] })()");
  const data = { items: [], files: paths, dragOperationsMask: 1 };
  for (const type of ['dragEnter', 'dragOver', 'drop']) await page.send('Input.dispatchDragEvent', { type, x, y, data });
  await page.until("location.pathname.startsWith('/upload/') && document.readyState === 'complete'", 'dropped files are looked at');
  await judge(page, 'draft', filled);
  writeFileSync(join(out, 'draft.png'), await page.picture());
  const before = await stored();
  const button = "[...document.querySelectorAll('button[value=store]')][0]";
  assert.match(await page.value(`${button}.textContent`), /Store 1 of 3 trials/);
  assert.equal(await page.value("document.querySelectorAll('.refusal').length"), 4, 'the photograph, of nobody, on no plant, and unknown columns');
  // Said by keyboard which column is which.
  await page.value("[...document.querySelectorAll('details')].forEach((one) => { one.open = true })");
  for (const [name, text] of Object.entries({ t: 'Clock', r: 'Target', u: 'Stick', y: 'Cursor' })) {
    await page.value(`document.querySelector('[name="1.${name}"]').focus()`);
    await page.send('Input.insertText', { text });
  }
  await page.value("document.querySelector('[name=\"1.time_unit\"]').value = 'ms'");
  await page.value("document.querySelector('button[value=look]').click()");
  await page.until("/Store 2 of 3/.test(document.querySelector('button[value=store]')?.textContent)", 'the columns are understood');
  await page.value(`${button}.click()`);
  await page.until("/2 trials are stored/.test(document.querySelector('main')?.textContent)", 'two are stored');
  assert.equal(await stored(), before + 2);
  writeFileSync(join(out, 'draft-stored.png'), await page.picture());
  await judge(page, 'draft-stored', filled);
  await page.close();
  const narrow = await browser.page(400, 'dark');
  await narrow.go(`${filled}/upload?study=${found.first}`);
  const { root } = await narrow.send('DOM.getDocument');
  const { nodeId } = await narrow.send('DOM.querySelector', { nodeId: root.nodeId, selector: 'input[type=file]' });
  await narrow.send('DOM.setFileInputFiles', { nodeId, files: paths });
  await narrow.value("document.querySelector('form[enctype] button').click()");
  await narrow.until("location.pathname.startsWith('/upload/') && document.readyState === 'complete'", 'chosen files are looked at');
  await judge(narrow, 'draft-dark-400', filled);
  writeFileSync(join(out, 'draft-dark-400.png'), await narrow.picture());
  await narrow.close();
}

// ---- from the form to the figure, without leaving the browser
{
  const page = await browser.page(1280, 'light');
  await page.go(`${filled}/analyses/new?kind=frequency_response&trial=${last}`);
  await page.value("document.querySelector('button[value=check]').click()");
  await page.until("/It is in order/.test(document.querySelector('main')?.textContent)", 'the form is checked');
  await judge(page, 'start-checked', filled);
  await page.value("document.querySelector('button[value=start]').click()");
  await page.until("location.pathname.startsWith('/analyses/') && document.querySelector('.status')?.textContent === 'succeeded'", 'it is computed');
  await page.until("document.querySelector('svg.fig[data-figure] path')", 'its figure is drawn');
  assert.deepEqual(page.errors, []);
  await page.close();
}

// ---- an excitation: another chip, another figure, without a mouse
{
  const page = await browser.page(1280, 'light');
  await page.go(`${filled}/excitation`);
  const drawn = "document.querySelector('.wide svg[data-figure=signal]').dataset.to";
  const first = await page.value(drawn);
  await page.value("document.querySelector('[name=chip_s]').select()");
  await page.send('Input.insertText', { text: '0.1' });
  await page.press('Enter');
  await page.until(`location.search.includes('chip_s=0.1') && ${drawn} !== '${first}'`, 'the figure is of the other chip');
  assert.deepEqual(page.errors, []);
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
  await page.until("document.querySelector('.status')?.textContent === 'succeeded'", 'the analysis is followed to its end', 280000);
  await page.until("[...document.querySelectorAll('h2')].some((one) => one.textContent === 'What it found')", 'the result is shown');
  assert.equal(await page.value('window.mark'), 7, 'the page was loaded again');
  await judge(page, 'analysis-followed', filled);
  writeFileSync(join(out, 'analysis-followed.png'), await page.picture());

  const long = await post('/v1/analyses', { kind: 'ssid', inputs: { trial: found.trials[0].id }, spec: { pool: 'zhang2015_appendix_c' } });
  await page.go(`${filled}/analyses/${long.id}`);
  await page.until("document.querySelector('.status')?.textContent === 'running' && document.querySelector('progress')", 'it runs');
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
  await page.go(`${filled}/studies/${found.first}/report`);
  const { data } = await page.send('Page.printToPDF', { paperWidth: 8.27, paperHeight: 11.69, printBackground: true });
  const pdf = Buffer.from(data, 'base64');
  writeFileSync(join(out, 'report.pdf'), pdf);
  assert.ok(pdf.subarray(0, 5).toString() === '%PDF-' && pdf.length > 20000, `${pdf.length} bytes of paper`);
  await page.close();
  // The file opens from a disk, with every figure, asking for nothing.
  const kept = join(out, 'report.html');
  writeFileSync(kept, Buffer.from(await (await fetch(`${filled}/studies/${found.first}/report.html`)).arrayBuffer()));
  const file = await browser.page(1280, 'light');
  await file.go(`file://${kept}`);
  assert.ok(await file.value("document.querySelectorAll('svg.fig').length") >= 3);
  assert.deepEqual(file.requests, [`file://${kept}`]);
  assert.deepEqual(file.errors, []);
  writeFileSync(join(out, 'report-file.png'), await file.picture());
  await file.close();
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
