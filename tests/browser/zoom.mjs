// How quickly a dragged stretch is seen: node zoom.mjs ADDRESS-OF-A-TRIAL (cargo bench --bench pages -- --serve prints one).
import assert from 'node:assert/strict';
import { Browser } from './chromium.mjs';

const [, , address] = process.argv;
const TIMES = 15;
// Milliseconds: until what is drawn moves, until the exact figure stands there, of the main thread for a zoom.
const BUDGET = { feedback: 50, exact: 100, cpu: 30 };

const browser = new Browser();
const page = await browser.page(1280, 'light');
await page.send('Performance.enable', { timeDomain: 'threadTicks' });
await page.go(address);
const busy = async () => {
  const { metrics } = await page.send('Performance.getMetrics');
  const of = (name) => metrics.find((metric) => metric.name === name).value;
  return 1000 * (of('ScriptDuration') + of('LayoutDuration') + of('RecalcStyleDuration'));
};
const [x, y, width] = await page.value("(() => { const b = document.querySelector('.wide .f-plot').getBoundingClientRect(); return [b.x, b.y + b.height / 2, b.width] })()");
// The page itself notes when it moves, and when the new figure stands there.
await page.value(`(() => {
  const box = document.querySelector('.wide .f-plot').closest('.plot > div');
  addEventListener('pointerup', () => { window.began = performance.now(); window.moved = window.stood = undefined; }, true);
  new MutationObserver((changes) => {
    for (const change of changes) {
      if (change.type === 'attributes') requestAnimationFrame(() => { window.moved ??= performance.now() - window.began; });
      if (change.type === 'childList' && [...change.addedNodes].some((node) => node.classList?.contains('fig'))) requestAnimationFrame(() => { window.stood ??= performance.now() - window.began; });
    }
  }).observe(box, { attributes: true, attributeFilter: ['transform'], childList: true, subtree: true });
})()`);
const taken = { feedback: [], exact: [], cpu: [] };
for (let i = 0; i < TIMES; i += 1) {
  const before = await busy();
  await page.mouse('mousePressed', x + 0.3 * width, y);
  await page.mouse('mouseMoved', x + 0.5 * width, y);
  await page.mouse('mouseReleased', x + 0.6 * width, y);
  await page.until('window.stood !== undefined', 'the exact figure stands there');
  const [moved, stood] = await page.value('[window.moved, window.stood]');
  taken.feedback.push(moved);
  taken.exact.push(stood);
  taken.cpu.push(await busy() - before);
  await page.value("document.querySelector('.wide svg.fig').focus()");
  await page.press('0');
  await page.until("Number(document.querySelector('.wide svg.fig').dataset.from) === 0", 'the whole is there again');
}
await browser.close();
const late = [];
for (const [name, all] of Object.entries(taken)) {
  all.sort((a, b) => a - b);
  const [half, most] = [all[Math.floor(TIMES / 2)], all.at(-1)];
  console.log(`${name}: ${half.toFixed(0)} ms in the middle, ${most.toFixed(0)} ms at most; budget ${BUDGET[name]} ms`);
  if (half > BUDGET[name]) late.push(name);
}
assert.deepEqual(late, []);
