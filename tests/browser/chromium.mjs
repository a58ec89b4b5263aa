// Chromium, driven over a pipe: no port, no library.
import { spawn } from 'node:child_process';
import { mkdtempSync, rmSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';

/** A browser of the test's own, without a profile. */
export class Browser {
  constructor() {
    this.folder = mkdtempSync(join(tmpdir(), 'volition-browser-'));
    const flags = ['--headless=new', '--no-sandbox', '--disable-gpu', '--disable-dev-shm-usage', '--no-first-run',
      '--disable-background-networking', '--disable-component-update', '--disable-default-apps', '--hide-scrollbars',
      '--force-device-scale-factor=1', `--user-data-dir=${this.folder}`, '--remote-debugging-pipe', 'about:blank'];
    this.process = spawn('chromium', flags, { stdio: ['ignore', 'ignore', 'ignore', 'pipe', 'pipe'] });
    this.last = 0;
    this.waiting = new Map();
    this.pages = new Map();
    let text = '';
    this.process.stdio[4].setEncoding('utf8');
    this.process.stdio[4].on('data', (chunk) => {
      text += chunk;
      for (let at = text.indexOf('\0'); at >= 0; at = text.indexOf('\0')) {
        const message = JSON.parse(text.slice(0, at));
        text = text.slice(at + 1);
        this.take(message);
      }
    });
    this.process.on('exit', () => {
      for (const { refuse } of this.waiting.values()) refuse(new Error('the browser ended'));
    });
  }

  take(message) {
    if (message.id) {
      const { done, refuse, method } = this.waiting.get(message.id);
      this.waiting.delete(message.id);
      if (message.error) refuse(new Error(`${method}: ${message.error.message}`)); else done(message.result);
    } else {
      this.pages.get(message.sessionId)?.take(message.method, message.params);
    }
  }

  send(method, params = {}, sessionId = undefined) {
    this.last += 1;
    const id = this.last;
    this.process.stdio[3].write(`${JSON.stringify({ id, method, params, sessionId })}\0`);
    return new Promise((done, refuse) => { this.waiting.set(id, { done, refuse, method }); });
  }

  /** A new page of this width, on a system of this theme. */
  async page(width, theme) {
    const { browserContextId } = await this.send('Target.createBrowserContext');
    const { targetId } = await this.send('Target.createTarget', { url: 'about:blank', browserContextId });
    const { sessionId } = await this.send('Target.attachToTarget', { targetId, flatten: true });
    const page = new Page(this, sessionId, targetId);
    this.pages.set(sessionId, page);
    for (const domain of ['Page', 'Runtime', 'Network', 'Log', 'DOM']) await page.send(`${domain}.enable`);
    await page.send('Emulation.setDeviceMetricsOverride', { width, height: 900, deviceScaleFactor: 1, mobile: false });
    await page.send('Emulation.setEmulatedMedia', { features: [{ name: 'prefers-color-scheme', value: theme }] });
    return page;
  }

  async close() {
    const ended = new Promise((done) => { this.process.on('exit', done); });
    await this.send('Browser.close').catch(() => {});
    await ended;
    rmSync(this.folder, { recursive: true, force: true, maxRetries: 5 });
  }
}

const pause = (ms) => new Promise((done) => { setTimeout(done, ms); });

/** A page, with everything that went wrong on it. */
class Page {
  constructor(browser, session, target) {
    Object.assign(this, { browser, session, target, errors: [], requests: [], loads: 0 });
  }

  take(method, params) {
    if (method === 'Runtime.exceptionThrown') this.errors.push(params.exceptionDetails.exception?.description ?? params.exceptionDetails.text);
    if (method === 'Runtime.consoleAPICalled' && params.type === 'error') this.errors.push(JSON.stringify(params.args.map((one) => one.value)));
    if (method === 'Log.entryAdded' && params.entry.level === 'error') this.errors.push(`${params.entry.text} ${params.entry.url ?? ''}`);
    if (method === 'Network.requestWillBeSent') this.requests.push(params.request.url);
    if (method === 'Page.loadEventFired') this.loads += 1;
  }

  send(method, params) { return this.browser.send(method, params, this.session); }

  async go(url) {
    const before = this.loads;
    const { errorText } = await this.send('Page.navigate', { url });
    if (errorText) throw new Error(`${url}: ${errorText}`);
    await this.until(() => this.loads > before, `${url} is loaded`);
    // The event may have been that of a page before.
    const path = JSON.stringify(new URL(url).pathname);
    await this.until(`document.readyState === 'complete' && location.pathname === ${path}`, `${url} is there`);
  }

  /** The value of an expression of the page. */
  async value(expression) {
    const { result, exceptionDetails } = await this.send('Runtime.evaluate', { expression, awaitPromise: true, returnByValue: true });
    if (exceptionDetails) throw new Error(`${expression.slice(0, 120)}: ${exceptionDetails.exception?.description ?? exceptionDetails.text}`);
    return result.value;
  }

  /** Waits until something holds: a function here, or an expression of the page. */
  async until(holds, what = String(holds), patience = 120000) {
    const began = Date.now();
    let last = '';
    // While a page is loaded there may be nothing yet to look at.
    const seen = () => this.value(holds).catch((error) => { last = `; last: ${error.message}`; return false; });
    while (!(typeof holds === 'string' ? await seen() : holds())) {
      if (Date.now() - began > patience) throw new Error(`it does not come to pass: ${what}${last}`);
      await pause(40);
    }
  }

  async press(key, code = key) {
    const text = key.length === 1 ? key : key === 'Enter' ? '\r' : undefined;
    const codes = { Enter: 13, Tab: 9, Escape: 27, ArrowRight: 39, ArrowLeft: 37, ArrowDown: 40, Home: 36, End: 35 };
    const own = { key, code, text, windowsVirtualKeyCode: codes[key] };
    await this.send('Input.dispatchKeyEvent', { type: 'keyDown', ...own });
    await this.send('Input.dispatchKeyEvent', { type: 'keyUp', ...own });
  }

  async mouse(type, x, y, more = {}) {
    await this.send('Input.dispatchMouseEvent', { type, x, y, button: 'left', buttons: 1, clickCount: 1, ...more });
  }

  async picture(whole = true) {
    const { data } = await this.send('Page.captureScreenshot', { format: 'png', captureBeyondViewport: whole });
    return Buffer.from(data, 'base64');
  }

  async close() { await this.browser.send('Target.closeTarget', { targetId: this.target }); }
}
