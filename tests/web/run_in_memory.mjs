// Runs run_in_memory.cpp on a recording and prints what it says, as the programs of tests/bits do:
//
//   node run_in_memory.mjs PROGRAM.wasm RECORDING [CHANGED_FRAME]
import {readFileSync} from 'node:fs';
import process from 'node:process';

const [program, file, changed = '-1'] = process.argv.slice(2);
if (!file) {
  console.error('usage: run_in_memory.mjs PROGRAM.wasm RECORDING [CHANGED_FRAME]');
  process.exit(2);
}
const {instance} = await WebAssembly.instantiate(readFileSync(program), {});
const {memory, run, said_text, __heap_base} = /** @type {any} */ (instance.exports);
const recording = readFileSync(file);
const at = __heap_base.value;
memory.grow(Math.ceil(Math.max(0, at + recording.length - memory.buffer.byteLength) / 65536));
new Uint8Array(memory.buffer).set(recording, at);
const code = run(at, recording.length, Number(changed));
const bytes = new Uint8Array(memory.buffer);
process.stdout.write(new TextDecoder().decode(bytes.slice(said_text(), bytes.indexOf(0, said_text()))));
process.exit(code);
