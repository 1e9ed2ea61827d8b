// compare.mjs SCREENSHOT DRAWN LIT [WORST]: compares each picture of a screenshot of page.html with DRAWN, a .pfm of
// host_lightmap: as a screen shows it, and the last one exposed and tone-mapped as in LIT, scene_lit.glb.
// Prints the root mean square difference over blocks of 4 x 4 pixels, as a share of the mean. Exit status 1 if one
// exceeds WORST, by default 0.01.
import fs from 'node:fs';
import { decode } from './png.mjs';

const [screenshot, drawn, lit, worst = 0.01] = process.argv.slice(2);
const names = ['scene.gltf', 'with atlas.exr', 'with atlas.ktx2', 'with atlas.hdr', 'user.glb',
               'user.gltf with atlas.exr', 'scene_lit.glb'];

function read_pfm(file) {
    const [, width, height] = file.toString('latin1', 0, 64).split(/\s+/).map(Number);
    const start = file.length - 12 * width * height;
    const at = (x, y) => [0, 1, 2].map((k) => file.readFloatLE(start + 12 * ((height - 1 - y) * width + x) + 4 * k));
    return { width, height, at };
}
const linear = (byte) => byte <= 0.04045 * 255 ? byte / 255 / 12.92 : ((byte / 255 + 0.055) / 1.055) ** 2.4;

// PBR Neutral, written by its definition: https://github.com/KhronosGroup/ToneMapping
function neutral(rgb) {
    const x = Math.min(...rgb), offset = x < 0.08 ? x - 6.25 * x * x : 0.04, c = rgb.map((v) => v - offset);
    const peak = Math.max(...c), start = 0.8 - 0.04, d = 1 - start;
    if (peak < start) return c;
    const shown = 1 - d * d / (peak + d - start), g = 1 - 1 / (0.15 * (peak - shown) + 1);
    return c.map((v) => v * shown / peak * (1 - g) + shown * g);
}

const glb = fs.readFileSync(lit), extras = JSON.parse(glb.toString('utf8', 20, 20 + glb.readUInt32LE(12))).asset.extras;
const truth = read_pfm(fs.readFileSync(drawn)), seen = decode(fs.readFileSync(screenshot));
const { width, height } = truth, exposed = 2 ** extras.exposure_stops;
if (seen.width !== width || seen.height !== names.length * height) throw new Error('the screenshot has another size');

const LAST = names.length - 1;
let failed = extras.tone !== 'PBR Neutral';
names.forEach((name, number) => {
    const shown = (x, y) => (number < LAST ? truth.at(x, y) : neutral(truth.at(x, y).map((v) => v * exposed)))
        .map((v) => Math.min(Math.max(v, 0), 1));
    let squares = 0, sum = 0, count = 0;
    for (let y = 0; y < height; y += 4)
        for (let x = 0; x < width; x += 4)
            for (let k = 0; k < 3; k++) {
                let difference = 0;
                for (let i = 0; i < 16; i++) {
                    const column = x + i % 4, row = y + (i >> 2), value = shown(column, row)[k];
                    const at = ((number * height + row) * width + column) * seen.channels + k;
                    difference += (linear(seen.data[at]) - value) / 16;
                    sum += value / 16;
                }
                squares += difference * difference;
                count++;
            }
    const share = Math.sqrt(squares / count) / (sum / count);
    failed ||= !(share <= worst);
    console.log(`${name}: ${(100 * share).toFixed(2)} %`);
});
process.exit(failed ? 1 : 0);
