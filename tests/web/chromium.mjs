// The page in headless Chromium, before a camera that shows 20 seconds of the emulated phone's desk: what it tracks,
// that the native program repeats its recording with the same bits, what it asks the network for, and that it survives
// what browsers do to pages. Pictures and the recording are left in the folder WORK.
//
//   node chromium.mjs WEB PROGRAM CAMERA.y4m WORK [CHROMIUM]
//
// Exit code 77: there is no browser, no program or no camera.
import assert from 'node:assert/strict';
import {spawnSync} from 'node:child_process';
import {createHash} from 'node:crypto';
import {existsSync, mkdirSync, readdirSync, readFileSync, rmSync, writeFileSync} from 'node:fs';
import {join, resolve} from 'node:path';
import process from 'node:process';

import {Browser, serve} from './browser.mjs';

const [web, program, camera, work, chromium = '/usr/bin/chromium'] = process.argv.slice(2).map((path) => resolve(path));
for (const needed of [web, program, camera, chromium]) {
  if (existsSync(needed)) continue;
  console.log(`skipped: ${needed} is not here`);
  process.exit(77);
}
rmSync(work, {recursive: true, force: true});
mkdirSync(work, {recursive: true});

const kPolicy = 'default-src \'self\'; script-src \'self\' \'wasm-unsafe-eval\'';
const kFakeCamera = ['--use-fake-device-for-media-stream', `--use-file-for-fake-video-capture=${camera}`];
const kAccept = '--use-fake-ui-for-media-stream';
const wait = (/** @type {number} */ seconds) => new Promise((done) => setTimeout(done, 1000 * seconds));
const click = (/** @type {string} */ id) => `document.getElementById('${id}').click()`;
const set = (/** @type {string} */ id, /** @type {any} */ value) =>
    `{const e = document.getElementById('${id}'); e.value = '${value}'; e.dispatchEvent(new Event('change'))}`;
// The emulated phone.
const kPhone = set('kind', 0) + set('fov', '48.0872') + set('readout', 60) + set('lines', 'columns -');
const kReady = 'window.pocketPtam?.version !== undefined && pocketPtam.version !== ""';

/** @param {string} name @param {() => Promise<void>} work */
async function step(name, work) {
  const begun = Date.now();
  await work();
  console.log(`${name}: ${((Date.now() - begun) / 1000).toFixed(1)} s`);
}
/** @param {import('./browser.mjs').Page} page @param {string} name */
async function picture(page, name) {
  const {data} = await page.call('Page.captureScreenshot', {format: 'png'});
  writeFileSync(join(work, name), Buffer.from(data, 'base64'));
}
const digest = (/** @type {Uint8Array} */ bytes) => createHash('md5').update(bytes).digest('hex');
/** The number of each picture of a film, by its luminance. @param {Buffer} y4m @param {number} pixels of a frame */
function luminances(y4m, pixels) {
  const numbers = new Map();
  for (let at = y4m.indexOf('\n') + 1, i = 0; at < y4m.length; ++i) {
    at = y4m.indexOf('\n', at) + 1;  // FRAME
    numbers.set(digest(y4m.subarray(at, at + pixels)), i);
    at += pixels * 3 / 2;
  }
  return numbers;
}

const upright = {
  width: 420,
  height: 800,
  deviceScaleFactor: 1,
  mobile: true,
  screenOrientation: {type: 'portraitPrimary', angle: 0}
};
const more = (/** @type {number} */ frames) => `(globalThis.from ??= pocketPtam.tracked, pocketPtam.tracked >= from + ${
    frames} && (delete globalThis.from, true))`;

const server = await serve(web, () => kPolicy);
let browser = new Browser(chromium, [...kFakeCamera, kAccept]);
try {
  const page = await browser.page();
  await browser.call('Browser.setDownloadBehavior', {behavior: 'allow', downloadPath: work});
  await page.call('Emulation.setDeviceMetricsOverride', upright);

  /** @type {any} */
  let s;
  const tar = join(work, 'pocket-ptam-recording.tar');
  await step('20 seconds, from the first frame on', async () => {
    for (let attempt = 1; attempt <= 3; ++attempt) {
      rmSync(tar, {force: true});
      await page.open(server.origin + '/');
      await page.until(kReady);
      await page.evaluate(kPhone + click('start'));
      await page.until('pocketPtam.tracked > 0');
      await page.evaluate(click('record'));
      const until = await page.evaluate('pocketPtam.arrived') + 300;
      await page.until('pocketPtam.state === "tracking"');
      await wait(3);
      await picture(page, 'early.png');
      await page.until(`pocketPtam.arrived >= ${until}`);
      await picture(page, 'late.png');
      await page.evaluate(click('record'));
      await page.until('pocketPtam.recorded > 0');
      s = await page.evaluate('({...pocketPtam, result: null})');
      console.log(
          `${s.arrived} frames arrived, ${s.dropped} of them passed over for newer ones; ${s.poses} of ${s.since} ` +
          `tracked since the first pose; ${s.simd ? 'with' : 'without'} vectors`);
      if (s.dropped <= 0.1 * s.arrived) return;
      console.log('more than a tenth was passed over: the computer is too busy for a browser');
    }
  });
  const images = join(work, 'pocket-ptam-recording', 'rgb');
  await step('what the tracker got is what the camera showed, when it did', async () => {
    for (let i = 0; !existsSync(tar) && i < 50; ++i) await wait(0.2);
    assert.equal(spawnSync('tar', ['xf', tar, '-C', work]).status, 0);
    const shown = luminances(readFileSync(camera), 240 * 320);
    const late = readdirSync(images)
                     .map((name) => {
                       const i = shown.get(digest(readFileSync(join(images, name)).subarray(-240 * 320)));
                       assert.notEqual(i, undefined, `${name} is no image of the camera`);
                       return parseFloat(name) - i / 15;
                     })
                     .sort((a, b) => a - b);
    // Where the computer is busy the camera itself is late, for some frames or for seconds. Earlier than a camera in
    // time by half a period or more would be a picture with the time of the one before.
    const inTime = late[Math.floor(0.1 * late.length)];
    const [first, last] = [late[0] - inTime, late[late.length - 1] - inTime].map((seconds) => 1000 * seconds);
    console.log(`capture times: ${first.toFixed(1)} to ${last.toFixed(1)} ms from an even rate`);
    assert.ok(first > -500 / 15, 'a picture has the time of the one before');
  });

  await step('the native program repeats it', async () => {
    const repeat = () => spawnSync(
        program, ['replay', join(work, 'pocket-ptam-recording'), '--no-overlay', '--out', join(work, 'out')],
        {encoding: 'utf8'});
    const {status, stdout, stderr} = repeat();
    assert.equal(status, 0, stderr + stdout);
    console.log(stderr.split('\n').filter((line) => /^(frames|tracked|map hash)/.test(line)).join('\n'));
    const file = join(images, readdirSync(images).sort((a, b) => parseFloat(a) - parseFloat(b))[9]);
    const head = spawnSync('head', ['-c', '15', file]).stdout;
    writeFileSync(file, Buffer.concat([head, Buffer.alloc(240 * 320, 90)]));
    assert.match(repeat().stderr, /other bits/, 'control: another picture is found out');
  });

  assert.ok(s.poses >= 0.98 * s.since, `${s.poses} of ${s.since} is under 98 %`);
  assert.ok(s.since > 150 && s.refused === 0 && s.simd && s.drawn === s.tracked);

  await step('a map saved, forgotten, loaded', async () => {
    await page.evaluate(click('save'));
    await page.until('/is kept in this browser/.test(pocketPtam.said)');
    await page.evaluate(click('reset'));
    await page.until('pocketPtam.result.maps === 0');
    await page.evaluate(click('load'));
    await page.until('pocketPtam.result.maps >= 1 && pocketPtam.state === "tracking"');
    await page.evaluate(click('lock'));
    await page.until('document.getElementById("lock").getAttribute("aria-pressed") === "true"');
    await page.evaluate(click('lock'));
  });

  await step('a lost WebGL context', async () => {
    await page.evaluate(
        'globalThis.loser = document.getElementById("canvas").getContext("webgl")' +
        '.getExtension("WEBGL_lose_context"), loser.loseContext()');
    await page.until(
        '(globalThis.drawn ??= pocketPtam.drawn, globalThis.seen ??= pocketPtam.tracked, ' +
        'pocketPtam.tracked > seen + 10)');
    assert.ok(await page.evaluate('pocketPtam.drawn <= drawn + 1'));
    await page.evaluate('loser.restoreContext()');
    await page.until('pocketPtam.drawn > drawn + 10');
    await picture(page, 'restored.png');
  });

  await step('a hidden tab', async () => {
    const other = await browser.call('Target.createTarget', {url: 'about:blank'});
    await browser.call('Target.activateTarget', {targetId: other.targetId});
    await page.until('document.visibilityState === "hidden"');
    await wait(2);
    await browser.call('Target.activateTarget', {targetId: page.target});
    await browser.call('Target.closeTarget', {targetId: other.targetId});
    await page.until('document.visibilityState === "visible"');
    await page.until(more(20));
  });

  await step('a rotated screen', async () => {
    await page.evaluate(set('lines', ''));  // as phones have them
    await page.until('pocketPtam.camera.shutter_axis === 1 && pocketPtam.camera.line_time_s < 0');
    await page.call(
        'Emulation.setDeviceMetricsOverride',
        {...upright, width: 800, height: 420, screenOrientation: {type: 'landscapePrimary', angle: 90}});
    await page.until('pocketPtam.camera.shutter_axis === 0 && pocketPtam.camera.line_time_s > 0');
    await page.until(more(20));
    assert.ok(await page.evaluate('document.getElementById("canvas").getBoundingClientRect().height <= innerHeight'));
    await picture(page, 'rotated.png');
  });

  assert.deepEqual(page.requests.filter((url) => !url.startsWith(server.origin + '/') && !url.startsWith('blob:')), []);
  assert.ok(page.requests.some((url) => url.endsWith('.wasm')), 'requests of the worker are seen');
  assert.deepEqual(page.complaints.filter((text) => !/404/.test(text)), []);  // favicon.ico
  assert.equal(await page.evaluate('pocketPtam.trouble'), '');

  await step('default-src \'self\' for the page itself; for the worker, too', async () => {
    const forPage = await serve(web, (path) => path === '/index.html' ? 'default-src \'self\'' : undefined);
    await page.open(forPage.origin + '/');
    await page.until(kReady);
    await page.evaluate(click('start'));
    await page.until('pocketPtam.tracked > 5');
    const forAll = await serve(web, () => 'default-src \'self\'');
    await page.open(forAll.origin + '/');
    await page.until('/wasm-unsafe-eval/.test(pocketPtam.trouble)');
    forPage.close(), forAll.close();
  });

  // What older browsers lack: taken away before the page is loaded.
  const withoutWebGL = `HTMLCanvasElement.prototype.getContext = (get => function(kind, ...rest) {
    return kind === 'webgl' ? null : get.call(this, kind, ...rest);
  })(HTMLCanvasElement.prototype.getContext)`;
  for (const [name, script, expected] of [
           ['VideoFrame', 'delete globalThis.VideoFrame', 'pocketPtam.drawn > 10'],
           [
             'requestVideoFrameCallback', 'delete HTMLVideoElement.prototype.requestVideoFrameCallback',
             'pocketPtam.drawn > 10'
           ],
           ['WebGL', withoutWebGL, 'pocketPtam.drawn === 0 && /no WebGL/.test(pocketPtam.trouble)'],
  ]) {
    await step(`without ${name}`, async () => {
      const {identifier} = await page.call('Page.addScriptToEvaluateOnNewDocument', {source: script});
      await page.open(server.origin + '/');
      await page.until(kReady);
      await page.evaluate(click('start'));
      await page.until(`pocketPtam.tracked > 15 && ${expected}`);
      await page.call('Page.removeScriptToEvaluateOnNewDocument', {identifier});
    });
  }

  await step('the example', async () => {
    await page.open(server.origin + '/example.html');
    await page.until('/move sideways|^-?[0-9.]+ -?[0-9.]+ -?[0-9.]+$/.test(document.querySelector("pre").textContent)');
  });

  await step('the one-file page, from a file', async () => {
    await page.open(`file://${web}/pocket-ptam.html`);
    await page.until(kReady);
    await page.evaluate(kPhone + click('start'));
    await page.until('pocketPtam.tracked > 20');
    await page.evaluate(click('tap'));
    await page.until('pocketPtam.state === "initialising"');
    await picture(page, 'file.png');
  });
  await browser.close();

  browser = new Browser(chromium, kFakeCamera);  // asks before it gives the camera
  await step('a camera refused, then allowed', async () => {
    const asking = await browser.page();
    const permission = (/** @type {string} */ setting) =>
        browser.call('Browser.setPermission', {permission: {name: 'camera'}, setting, origin: server.origin});
    await permission('denied');
    await asking.open(server.origin + '/');
    await asking.until(kReady);
    await asking.evaluate(click('start'));
    await asking.until('/was refused/.test(pocketPtam.trouble)');
    await picture(asking, 'refused.png');
    await permission('granted');
    await asking.evaluate(click('start'));
    await asking.until('pocketPtam.tracked > 5 && pocketPtam.trouble === ""');
  });
} catch (error) {
  console.log(`FAILED: ${error.stack}\n${browser.errors.slice(-1500)}`);
  process.exitCode = 1;
} finally {
  await browser.close();
  server.close();
}
