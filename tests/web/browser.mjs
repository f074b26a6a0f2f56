// A headless Chromium, spoken to by the DevTools protocol over its pipe, and a static web server that notes what it was
// asked for.
import {spawn} from 'node:child_process';
import {mkdtempSync, readFileSync, rmSync} from 'node:fs';
import {createServer} from 'node:http';
import {tmpdir} from 'node:os';
import {extname, join, normalize} from 'node:path';

const kTypes = {
  '.html': 'text/html',
  '.js': 'text/javascript',
  '.css': 'text/css'
};  // .wasm: like a server that knows none

/**
 * @param {string} folder @param {(path: string) => string|undefined} policy the Content-Security-Policy sent with a
 *     file
 */
export async function serve(folder, policy) {
  const asked = [];
  const server = createServer((request, response) => {
    const path = normalize(new URL(request.url, 'http://localhost').pathname).replace(/\/$/, '/index.html');
    asked.push(path);
    try {
      const body = readFileSync(join(folder, path));
      const headers = {'Content-Type': kTypes[extname(path)] || 'application/octet-stream'};
      const sent = policy(path);
      if (sent) headers['Content-Security-Policy'] = sent;
      response.writeHead(200, headers).end(body);
    } catch (error) {
      response.writeHead(404).end();
    }
  });
  await new Promise((resolve) => server.listen(0, '127.0.0.1', () => resolve(undefined)));
  const {port} = /** @type {any} */ (server.address());
  return {origin: `http://localhost:${port}`, asked, close: () => server.close()};
}

export class Browser {
  /** @param {string} program @param {string[]} options */
  constructor(program, options) {
    this.profile = mkdtempSync(join(tmpdir(), 'pptam-chromium-'));
    this.process = spawn(
        program,
        [
          '--headless=new', '--remote-debugging-pipe', '--no-sandbox', '--no-first-run', '--disable-gpu-sandbox',
          '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--disable-background-networking',
          '--disable-component-update', `--user-data-dir=${this.profile}`, ...options, 'about:blank'
        ],
        {stdio: ['ignore', 'ignore', 'pipe', 'pipe', 'pipe']});
    this.number = 0;
    /** @type {Map<number, {resolve: Function, reject: Function}>} */
    this.waiting = new Map();
    /** @type {any[]} every event */
    this.events = [];
    /** @type {((event: any) => void)[]} */
    this.listeners = [];
    this.errors = '';
    this.process.stderr.on('data', (data) => {
      this.errors += data;
    });
    let text = '';
    const decoder = new TextDecoder();
    /** @type {any} */ (this.process.stdio[4]).on('data', (data) => {
      text += decoder.decode(data, {stream: true});
      for (let end = text.indexOf('\0'); end >= 0; end = text.indexOf('\0')) {
        this.take(JSON.parse(text.slice(0, end)));
        text = text.slice(end + 1);
      }
    });
    this.ended = new Promise((resolve) => this.process.on('exit', resolve));
  }

  /** @param {any} message */
  take(message) {
    if (message.id === undefined) {
      this.events.push(message);
      for (const listener of this.listeners) listener(message);
      return;
    }
    const {resolve, reject} = this.waiting.get(message.id);
    this.waiting.delete(message.id);
    if (message.error)
      reject(new Error(message.error.message));
    else
      resolve(message.result);
  }

  /** @param {string} method @param {object} [params] @param {string} [sessionId] @returns {Promise<any>} */
  call(method, params = {}, sessionId) {
    const id = ++this.number;
    /** @type {any} */ (this.process.stdio[3]).write(JSON.stringify({id, method, params, sessionId}) + '\0');
    return new Promise((resolve, reject) => this.waiting.set(id, {resolve, reject}));
  }

  /** A page of its own. @param {string} [context] */
  async page(context) {
    const {targetId} = await this.call('Target.createTarget', {url: 'about:blank', browserContextId: context});
    const {sessionId} = await this.call('Target.attachToTarget', {targetId, flatten: true});
    const page = new Page(this, targetId, sessionId);
    // Workers' requests and messages, too.
    await page.call('Target.setAutoAttach', {autoAttach: true, waitForDebuggerOnStart: true, flatten: true});
    for (const domain of ['Page', 'Runtime', 'Network', 'Log']) await page.call(domain + '.enable');
    return page;
  }

  async close() {
    await Promise.race(
        [this.call('Browser.close').catch(() => {}), new Promise((resolve) => setTimeout(resolve, 3000))]);
    this.process.kill('SIGKILL');
    await this.ended;
    rmSync(this.profile, {recursive: true, force: true, maxRetries: 20});
  }
}

export class Page {
  /** @param {Browser} browser @param {string} target @param {string} session */
  constructor(browser, target, session) {
    this.browser = browser;
    this.target = target;
    this.session = session;
    /** @type {string[]} addresses that were asked for, by the page and its workers */
    this.requests = [];
    /** @type {string[]} */
    this.complaints = [];
    const sessions = new Set([session]);
    browser.listeners.push((event) => {
      if (!sessions.has(event.sessionId)) return;
      const p = event.params;
      if (event.method === 'Target.attachedToTarget') {
        sessions.add(p.sessionId);
        for (const method of ['Network.enable', 'Runtime.enable', 'Runtime.runIfWaitingForDebugger'])
          browser.call(method, {}, p.sessionId).catch(() => {});
      } else if (event.method === 'Network.requestWillBeSent') {
        this.requests.push(p.request.url);
      } else if (event.method === 'Runtime.exceptionThrown') {
        this.complaints.push(p.exceptionDetails.exception?.description || p.exceptionDetails.text);
      } else if (event.method === 'Log.entryAdded' && p.entry.level === 'error') {
        this.complaints.push(p.entry.text);
      }
    });
  }

  /** @param {string} method @param {object} [params] @returns {Promise<any>} */
  call(method, params) { return this.browser.call(method, params, this.session); }

  /** @param {string} url */
  async open(url) { await this.call('Page.navigate', {url}); }

  /** The value of an expression. @param {string} expression @returns {Promise<any>} */
  async evaluate(expression) {
    const answer =
        await this.call('Runtime.evaluate', {expression, awaitPromise: true, returnByValue: true, userGesture: true});
    if (answer.exceptionDetails)
      throw new Error(answer.exceptionDetails.exception?.description || answer.exceptionDetails.text);
    return answer.result.value;
  }

  /** Until the expression is true. @param {string} expression @param {number} [seconds] */
  async until(expression, seconds = 60) {
    const end = Date.now() + 1000 * seconds;
    for (;;) {
      if (await this.evaluate(expression).catch(() => false)) return;
      if (Date.now() > end)
        throw new Error(
            `after ${seconds} s still not: ${expression}; ${this.complaints.join('; ')}; ` +
            JSON.stringify(await this.evaluate('({...pocketPtam, result: null})').catch(() => null)));
      await new Promise((resolve) => setTimeout(resolve, 200));
    }
  }
}
