# The page with all its files in one, WEB/pocket-ptam.html: modules, worker and library as text in it, which a few lines
# turn into addresses (blob:) that import each other. Browsers load neither modules nor workers nor data from file:. The
# worker is one plain script: Chromium lets such a worker import nothing.
set(modules pocket_ptam grey recording tracker_worker cameras map_store house shaders renderer page)
file(READ ${WEB}/index.html html)
file(READ ${WEB}/style.css css)
string(REGEX REPLACE "<meta http-equiv[^>]*>\n" "" html "${html}")
string(REPLACE "<link rel=\"stylesheet\" href=\"style.css\">" "<style>\n${css}</style>" html "${html}")
set(texts "")
foreach(module IN LISTS modules)
  file(READ ${WEB}/${module}.js text)
  string(APPEND texts "<script type=\"text/plain\" id=\"${module}.js\">${text}</script>\n")
endforeach()
foreach(library pocket_ptam pocket_ptam_simd)
  file(READ ${WEB}/${library}.wasm hex HEX)
  string(APPEND texts "<script type=\"text/plain\" id=\"${library}.wasm\">${hex}</script>\n")
endforeach()
string(REPLACE ";" "," order "${modules}")
set(boot "<script type=\"module\">
const addresses = {};
for (const name of '${order}'.split(',')) {  // what a module imports stands before it
  const text = document.getElementById(name + '.js').textContent
    .replace(/from '\\.\\/(\\w+)\\.js'/g, (_, other) => `from '\${addresses[other]}'`);
  addresses[name] = URL.createObjectURL(new Blob([text], {type: 'text/javascript'}));
}
const plain = (name) => document.getElementById(name + '.js').textContent.replace(/^import .*$/gm, '')
  .replace(/^export /gm, '').replace(/import\\.meta\\.url/g, \"''\");
addresses.worker = URL.createObjectURL(new Blob(['pocket_ptam', 'grey', 'recording', 'tracker_worker'].map(plain),
                                                {type: 'text/javascript'}));
const {PocketPtam} = await import(addresses.pocket_ptam);
const simd = PocketPtam.simd();
const hex = document.getElementById(simd ? 'pocket_ptam_simd.wasm' : 'pocket_ptam.wasm').textContent;
const wasm = Uint8Array.from({length: hex.length / 2}, (_, i) => parseInt(hex.substr(2 * i, 2), 16)).buffer;
globalThis.pocketPtamFiles = {workerUrl: addresses.worker, wasm: {wasm, simd}};
await import(addresses.page);
</script>")
string(REPLACE "<script type=\"module\" src=\"page.js\"></script>" "${texts}${boot}" html "${html}")
file(WRITE ${WEB}/pocket-ptam.html "${html}")
