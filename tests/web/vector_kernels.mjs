// Runs vector_kernels.cpp with many seeds: node vector_kernels.mjs PROGRAM.wasm
import {readFileSync} from 'node:fs';
import process from 'node:process';

const {instance} = await WebAssembly.instantiate(readFileSync(process.argv[2]), {});
const {vector_kernels} = /** @type {any} */ (instance.exports);
const kNames = ['', 'half_row', 'window_sums', 'warp, zmssd_x64 or refine_sums', 'subtract_product'];
for (let seed = 1; seed <= 20000; ++seed) {
  const differs = vector_kernels(seed);
  if (differs === 0) continue;
  console.log(`FAILED: ${kNames[differs]} has other bits than the plain one, seed ${seed}`);
  process.exit(1);
}
console.log('passed: 20000 seeds');
