// Runs kernel_variants.cpp with many seeds: node kernel_variants.mjs PROGRAM.wasm
import {readFileSync} from 'node:fs';
import process from 'node:process';

const {instance} = await WebAssembly.instantiate(readFileSync(process.argv[2]), {});
const {kernel_variants} = /** @type {any} */ (instance.exports);
const kNames = ['', 'half_row', 'window_sums', 'warp, zmssd_x64 or refine_sums', 'fast_row', 'subtract_product'];
for (let seed = 1; seed <= 20000; ++seed) {
  const differs = kernel_variants(seed);
  if (differs === 0) continue;
  console.log(`FAILED: ${kNames[differs]} has other bits than the plain one, seed ${seed}`);
  process.exit(1);
}
console.log('passed: 20000 seeds');
