// Writes world.bin: the component around the core module of an FMU, without that module.
//
//   npm install @bytecodealliance/jco@1.35.0
//   node world.mjs WIT_FOLDER CORE_MODULE world.bin
//
// WIT_FOLDER: wit/ of github.com/modelica/fmi-ls-wasm at the commit that README.md names; CORE_MODULE: of any FMU,
// that is binaries/wasm32-wasip2/*.wasm of one that was built, or what zig links.
// A component is a sequence of sections, and each FMU has the same ones around its module: `fmus/build/wasm_fmu.py`
// puts the module into the first section of kind 1, which is empty here.
import { componentEmbed, componentNew } from '@bytecodealliance/jco';
import { readFile, readdir, writeFile } from 'node:fs/promises';

const [wit, core, output] = process.argv.slice(2);
const declared = /^package .*$/m;
const files = (await readdir(wit)).filter((name) => name.endsWith('.wit')).sort();
const texts = await Promise.all(files.map((name) => readFile(`${wit}/${name}`, 'utf8')));
const witSource = texts.map((text, i) => (i === 0 ? text : text.replace(declared, ''))).join('\n');
const embedded = await componentEmbed({ witSource, world: 'co-simulation-fmu', binary: await readFile(core) });
const component = Buffer.from(await componentNew(embedded));

const CUSTOM = 0, MODULE = 1, EMPTY = Buffer.from([MODULE, 8, 0x00, 0x61, 0x73, 0x6d, 1, 0, 0, 0]);
const kept = [component.subarray(0, 8)];
let at = 8, modules = 0;
while (at < component.length) {
    const start = at, kind = component[at++];
    let size = 0, shift = 0, byte;
    do { byte = component[at++]; size |= (byte & 0x7f) << shift; shift += 7; } while (byte & 0x80);
    at += size;
    if (kind === MODULE && modules++ === 0) kept.push(EMPTY);
    else if (kind !== CUSTOM) kept.push(component.subarray(start, at));
}
await writeFile(output, Buffer.concat(kept));
