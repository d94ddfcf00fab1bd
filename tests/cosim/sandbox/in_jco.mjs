// Runs an FMU's component as the JavaScript that jco makes of it: `node in_jco.mjs COMPONENT FOLDER`.
//
// FOLDER has @bytecodealliance/jco-transpile installed. The standard input is a run as JSON: the token, the step `h` in
// s, the value references of inputs and outputs, and the inputs of each step. Written are the outputs at the start and
// after each step, as float64.
import { readFileSync, writeFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import { join } from 'node:path';
import { pathToFileURL } from 'node:url';

const [component, folder] = process.argv.slice(2);
const { token, h, inputs, outputs, rows } = JSON.parse(readFileSync(0, 'utf8'));
const { resolve } = createRequire(join(folder, 'package.json'));
const { transpile } = await import(pathToFileURL(resolve('@bytecodealliance/jco-transpile')));
const { files } = await transpile(component, { name: 'fmu', instantiation: 'async' });
const made = join(folder, 'fmu.mjs');
writeFileSync(made, files['fmu.js']);
const { instantiate } = await import(pathToFileURL(made));

const said = [];
const { coSimulation } = await instantiate((name) => WebAssembly.compile(files[name]), {
    'fmi:fmi3/callbacks': { logMessage: (...line) => said.push(line) },
});
const ok = (status) => { if (status !== 'ok') throw new Error(`${status}: ${JSON.stringify(said)}`); };
const fmu = coSimulation.CoSimulationInstance.instantiateCoSimulation(
    'x', token, false, false, false, false, new Uint32Array());
const set = Uint32Array.from(inputs), get = Uint32Array.from(outputs);
ok(fmu.enterInitializationMode(undefined, 0, undefined));
ok(fmu.exitInitializationMode());
const found = [fmu.getFloat64(get)];
for (const [k, row] of rows.entries()) {
    ok(fmu.setFloat64(set, Float64Array.from(row)));
    fmu.doStep(k * h, h, true);
    found.push(fmu.getFloat64(get));
}
ok(fmu.terminate());
process.stdout.write(Buffer.concat(found.map((one) => Buffer.from(one.buffer, one.byteOffset, one.byteLength))));
