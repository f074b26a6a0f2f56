// The page's house stands where the native display's does: node house.mjs DUMP, the output of house_dump.cpp.
import assert from 'node:assert/strict';
import {existsSync, readFileSync} from 'node:fs';
import process from 'node:process';

import {placeHouse, siteModel} from '../../platform/web/house.js';

const [dump] = process.argv.slice(2);
if (!existsSync(dump)) {
  console.log(`skipped: no ${dump}: first tests/run.sh -R web`);
  process.exit(77);
}

/** The lines that the dump has for a pose. @param {number[]} numbers R by rows, t */
function linesOf(numbers) {
  const model =
      siteModel(placeHouse({R: Float32Array.from(numbers.slice(0, 9)), t: Float32Array.from(numbers.slice(9))}, 0.1));
  /** @type {[string, number[]][]} */
  const lines = [];
  const line = (/** @type {string} */ what, /** @type {number[]} */ values) => lines.push([what, values]);
  for (const what of ['ground', 'shadow', 'faces', 'edges']) {
    const part = model[what];
    if (Array.isArray(part)) {
      for (const {points, width} of part) {
        line(what, [points.length, width]);
        for (const {at, colour} of points) line(what, [...at, ...colour]);
      }
    } else {
      for (const {at, colour} of part.vertices) line(what, [...at, ...colour]);
      line(what, part.triangles);
    }
  }
  return lines;
}

let expected = [], checked = 0, poses = 0;
// Floats there, doubles here: some roundings of 6e-8 of coordinates up to a hundred. A colour's half may round
// otherwise.
const close = (/** @type {number} */ a, /** @type {number} */ b, /** @type {number} */ i) =>
    Math.abs(a - b) <= (i < 3 ? 1e-4 * Math.max(1, Math.abs(a)) : 1);
for (const text of readFileSync(dump, 'utf8').trim().split('\n')) {
  const [what, ...words] = text.split(' ');
  const numbers = words.map(Number);
  if (what === 'pose') {
    assert.equal(expected.length, 0);
    expected = linesOf(numbers);
    ++poses;
    continue;
  }
  const [name, values] = /** @type {[string, number[]]} */ (expected.shift());
  assert.equal(name, what);
  assert.equal(values.length, numbers.length);
  if (numbers.length === 7)
    values.forEach((value, i) => assert.ok(close(numbers[i], value, i), `${what}: ${text} is ${values}`));
  else
    assert.deepEqual(values.map(Math.fround), numbers.map(Math.fround));
  ++checked;
}
assert.ok(poses >= 20 && checked > 1000 && expected.length === 0);
console.log(`passed: ${poses} poses, ${checked} lines`);
