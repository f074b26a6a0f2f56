// The page in headless Firefox. Firefox has no camera that shows a film, so the page's camera is a canvas on which a
// script shows the emulated phone's desk: that the native program repeats the page's recording with the same bits, and
// what of it was tracked. The one-file page besides, with Firefox's own test picture.
//
//   node firefox.mjs WEB PROGRAM CAMERA.y4m WORK [FIREFOX]
//
// Exit code 77: there is no browser, no program or no camera.
import assert from 'node:assert/strict';
import {spawn, spawnSync} from 'node:child_process';
import * as fs from 'node:fs';
import {connect} from 'node:net';
import {tmpdir} from 'node:os';
import {join, resolve} from 'node:path';
import process from 'node:process';

import {serve} from './browser.mjs';

const [web, program, camera, work, firefox = '/usr/bin/firefox-esr'] =
    process.argv.slice(2).map((path) => resolve(path));
for (const needed of [web, program, camera, firefox]) {
  if (fs.existsSync(needed)) continue;
  console.log(`skipped: ${needed} is not here`);
  process.exit(77);
}
fs.rmSync(work, {recursive: true, force: true});
fs.mkdirSync(join(work, 'web'), {recursive: true});
for (const file of fs.readdirSync(web)) fs.copyFileSync(join(web, file), join(work, 'web', file));
fs.linkSync(camera, join(work, 'web', 'desk.y4m'));
fs.writeFileSync(
    join(work, 'web', 'index.html'),
    fs.readFileSync(join(web, 'index.html'), 'utf8').replace('<script', '<script src="show.js"></script>\n<script'));
const wait = (/** @type {number} */ seconds) => new Promise((done) => setTimeout(done, 1000 * seconds));

/** Firefox's protocol for tests: length:[0, number, method, parameters]. */
class Marionette {
  /** @param {number} port */
  constructor(port) {
    this.profile = fs.mkdtempSync(join(tmpdir(), 'pptam-firefox-'));
    const settings = {
      'marionette.port': port,
      'media.navigator.streams.fake': true,
      'media.navigator.permission.disabled': true,
      'browser.download.folderList': 2,
      'browser.download.dir': work,
      'browser.shell.checkDefaultBrowser': false,
      'browser.helperApps.neverAsk.saveToDisk': 'application/x-tar',
      'app.update.enabled': false,
      'datareporting.policy.dataSubmissionEnabled': false,
      'network.captive-portal-service.enabled': false,
    };
    fs.writeFileSync(
        join(this.profile, 'user.js'),
        Object.entries(settings).map(([name, value]) => `user_pref("${name}", ${JSON.stringify(value)});\n`).join(''));
    this.process = spawn(
        firefox, ['--headless', '--marionette', '--no-remote', '--profile', this.profile],
        {stdio: 'ignore', env: {...process.env, HOME: this.profile}});
    this.ended = new Promise((done) => this.process.on('exit', done));
    this.port = port;
    this.number = 0;
    /** @type {Map<number, {done: Function, failed: Function}>} */
    this.waiting = new Map();
  }

  async open() {
    for (let i = 0; !this.socket && i < 60; ++i) {
      await wait(0.5);
      this.socket = await new Promise((done) => {
        const socket = connect(this.port, '127.0.0.1', () => done(socket));
        socket.on('error', () => done(null));
      });
    }
    let bytes = Buffer.alloc(0);
    this.socket.on('data', (/** @type {Buffer} */ data) => {
      bytes = Buffer.concat([bytes, data]);
      for (let colon = bytes.indexOf(':'); colon > 0; colon = bytes.indexOf(':')) {
        const end = colon + 1 + Number(bytes.subarray(0, colon));
        if (bytes.length < end) return;
        const message = JSON.parse(bytes.subarray(colon + 1, end).toString());
        bytes = bytes.subarray(end);
        if (!Array.isArray(message)) continue;  // the greeting
        const {done, failed} = this.waiting.get(message[1]);
        if (message[2])
          failed(new Error(message[2].message));
        else
          done(message[3]);
      }
    });
    await this.call('WebDriver:NewSession');
    await this.call('WebDriver:SetTimeouts', {script: 60000});
  }

  /** @param {string} method @param {object} [parameters] @returns {Promise<any>} */
  call(method, parameters = {}) {
    const text = JSON.stringify([0, ++this.number, method, parameters]);
    this.socket.write(`${Buffer.byteLength(text)}:${text}`);
    return new Promise((done, failed) => this.waiting.set(this.number, {done, failed}));
  }

  /** The value of an expression, in the page's own world. @param {string} expression @returns {Promise<any>} */
  async evaluate(expression) {
    const script = `const [done] = arguments; Promise.resolve(${expression}).then(
      (value) => done(JSON.stringify(value) ?? null), (error) => done(null))`;
    const {value} = await this.call('WebDriver:ExecuteAsyncScript', {script, args: []});
    return value === null ? null : JSON.parse(value);
  }

  /** @param {string} expression @param {number} [seconds] */
  async until(expression, seconds = 60) {
    for (const end = Date.now() + 1000 * seconds; !await this.evaluate(expression).catch(() => false); await wait(0.3))
      if (Date.now() > end)
        throw new Error(`after ${seconds} s still not: ${expression}; ${
            JSON.stringify(await this.evaluate('({...pocketPtam, result: null})'))}`);
  }

  async close() {
    this.socket?.destroy();
    this.process.kill('SIGKILL');
    await this.ended;
    fs.rmSync(this.profile, {recursive: true, force: true, maxRetries: 20});
  }
}

// The page's camera: the film on a canvas, 15 images a second.
const kShow = `navigator.mediaDevices.getUserMedia = async () => {
  const film = new Uint8Array(await (await fetch('desk.y4m')).arrayBuffer());
  const pixels = 240 * 320, size = 6 + 1.5 * pixels, head = film.indexOf(10) + 1;
  const canvas = Object.assign(document.createElement('canvas'), {width: 240, height: 320});
  const context = canvas.getContext('2d'), image = context.createImageData(240, 320);
  image.data.fill(255);
  const begun = performance.now();
  let shown = -1;
  setInterval(() => {
    const i = Math.floor((performance.now() - begun) * 0.015);
    if (i === shown || head + (i + 1) * size > film.length) return;
    shown = i;
    for (let at = head + i * size + 6, to = 0; to < 4 * pixels; ++at, to += 4)
      image.data[to] = image.data[to + 1] = image.data[to + 2] = film[at];
    context.putImageData(image, 0, 0);
  }, 5);
  return canvas.captureStream();
};
`;
fs.writeFileSync(join(work, 'web', 'show.js'), kShow);
const set = (/** @type {string} */ id, /** @type {any} */ value) => `(document.getElementById('${id}').value = '${
    value}', document.getElementById('${id}').dispatchEvent(new Event('change')))`;
const click = (/** @type {string} */ id) => `document.getElementById('${id}').click()`;

const server = await serve(join(work, 'web'), () => 'default-src \'self\'; script-src \'self\' \'wasm-unsafe-eval\'');
const browser = new Marionette(20000 + process.pid % 20000);
try {
  await browser.open();
  await browser.call('WebDriver:Navigate', {url: server.origin + '/'});
  await browser.until('pocketPtam.version !== ""');
  console.log(await browser.evaluate('navigator.userAgent'));
  for (const [id, value] of Object.entries({kind: 0, fov: '48.0872', readout: 60, lines: 'columns -'}))
    await browser.evaluate(set(id, value));
  await browser.evaluate(click('start'));
  await browser.until('pocketPtam.tracked > 0');
  await browser.evaluate(click('record'));
  await browser.until('pocketPtam.poses > 150');
  const {value} = await browser.call('WebDriver:TakeScreenshot');
  fs.writeFileSync(join(work, 'page.png'), Buffer.from(value, 'base64'));
  await browser.evaluate(click('record'));
  await browser.until('pocketPtam.recorded > 0');
  const s = await browser.evaluate('({...pocketPtam, result: null})');
  console.log(
      `${s.arrived} frames arrived, ${s.dropped} passed over; ${s.poses} of ${s.since} tracked since the first pose; ` +
      `${s.simd ? 'with' : 'without'} vectors; ${s.drawn ? 'the house was drawn' : s.trouble}`);
  const tar = join(work, 'pocket-ptam-recording.tar');
  for (let i = 0; !fs.existsSync(tar) && i < 50; ++i) await wait(0.2);
  await wait(1);
  assert.equal(spawnSync('tar', ['xf', tar, '-C', work]).status, 0);
  const {status, stderr} = spawnSync(
      program, ['replay', join(work, 'pocket-ptam-recording'), '--no-overlay', '--out', join(work, 'out')],
      {encoding: 'utf8'});
  assert.equal(status, 0, stderr);
  console.log('the native program repeats it with the same bits');

  await browser.call('WebDriver:Navigate', {url: `file://${web}/pocket-ptam.html`});
  await browser.until('pocketPtam.version !== ""');
  await browser.evaluate(click('start'));
  await browser.until('pocketPtam.tracked > 20');
  console.log('the one-file page works from a file');
} catch (error) {
  console.log(`FAILED: ${error.stack}`);
  process.exitCode = 1;
} finally {
  await browser.close();
  server.close();
}
