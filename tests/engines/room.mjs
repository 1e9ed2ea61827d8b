// room.mjs FOLDER: writes room.gltf, a room of matte surfaces with second texture coordinates: a textured floor, walls
// of different colours, a lamp, a box, and a fence with holes. Each quad is a chart of its own. Two nodes use the last
// quad and have places in the map.
import fs from 'node:fs';
import { encode } from './png.mjs';

const folder = process.argv[2], ACROSS = 4;  // charts in a row of the map
// The tiles are coarse and soft, because viewers differ in how they shrink a texture.
const tiles = encode(16, 16, (x, y) => {
    const wave = 0.5 + 0.5 * Math.sin(x * Math.PI / 8) * Math.sin(y * Math.PI / 8);
    return [110 + 100 * wave, 120 + 70 * wave, 150 - 60 * wave, 255];
});
const fence = encode(8, 8, (x, y) => [150, 110 + 8 * y, 70, x % 4 < 2 || y % 4 < 1 ? 255 : 0]);

// materials: base colour, texture, emission
const materials = [
    { color: [1, 1, 1], texture: 0 }, { color: [0.7, 0.7, 0.7] }, { color: [0.65, 0.2, 0.15] },
    { color: [0.2, 0.5, 0.25] }, { color: [0, 0, 0], emission: 6 }, { color: [0.3, 0.4, 0.8] },
    { color: [1, 1, 1], texture: 1, cutoff: 0.5 }
];
// a quad: a corner, its two edges, and its material
const quads = [
    [[-2, 0, 2], [4, 0, 0], [0, 0, -4], 0],        // floor
    [[-2, 3, -2], [4, 0, 0], [0, 0, 4], 1],        // ceiling
    [[-2, 0, -2], [4, 0, 0], [0, 3, 0], 1],        // back
    [[-2, 0, 2], [0, 0, -4], [0, 3, 0], 2],        // left
    [[2, 0, -2], [0, 0, 4], [0, 3, 0], 3],         // right
    [[-0.6, 2.5, -0.6], [1.2, 0, 0], [0, 0, 1.2], 4],
    [[-1.2, 0, -0.2], [0.9, 0, 0], [0, 0.9, 0], 5],  // box: front, top, right
    [[-1.2, 0.9, -0.2], [0.9, 0, 0], [0, 0, -0.9], 5],
    [[-0.3, 0, -0.2], [0, 0, -0.9], [0, 0.9, 0], 5],
    [[0.3, 0, -1.2], [1.3, 0, 0], [0, 1.2, 0], 6],
    [[0, 0, 0], [0.6, 0, -0.3], [0, 0.8, 0], 5]     // shares the material of the box
];
// the nodes of the last quad: its charts are in these columns of the third row
const uses = [[-1.6, 1.5, -1, 2], [0.8, 1.4, -0.6, 3]].map(([x, y, z, column], i) => ({
    name: `use ${i}`, mesh: quads.length - 1, translation: [x, y, z],
    extras: { lightmapScaleOffset: [0.8 / ACROSS, 0.8 / ACROSS, (column + 0.1) / ACROSS, 2.1 / ACROSS] }
}));

const floats = [], indices = [0, 1, 2, 0, 2, 3], quad_bytes = 4 * (12 + 8 + 8);
const add = (a, b, c = [0, 0, 0]) => a.map((v, k) => v + b[k] + c[k]);
quads.forEach(([at, u, v], n) => {
    const corners = [at, add(at, u), add(at, u, v), add(at, v)], left = n % ACROSS, top = Math.floor(n / ACROSS);
    const place = (x, y) => n === quads.length - 1 ? [x, 1 - y]
                                                   : [(left + 0.1 + 0.8 * x) / ACROSS, (top + 0.9 - 0.8 * y) / ACROSS];
    const unit = [[0, 0], [1, 0], [1, 1], [0, 1]];
    floats.push(...corners.flat(), ...unit.flatMap(([x, y]) => [2 * x, 2 * (1 - y)]));
    floats.push(...unit.flatMap((c) => place(...c)));
});
const bin = Buffer.alloc(4 * floats.length + 24);
floats.forEach((v, i) => bin.writeFloatLE(v, 4 * i));
indices.forEach((v, i) => bin.writeUInt32LE(v, 4 * floats.length + 4 * i));

const views = [], accessors = [];
const view = (offset, length, accessor) => {
    views.push({ buffer: 0, byteOffset: offset, byteLength: length });
    accessors.push({ bufferView: views.length - 1, ...accessor });
};
quads.forEach(([at, u, v], n) => {
    const corners = [at, add(at, u), add(at, u, v), add(at, v)], start = n * quad_bytes;
    const bound = (pick) => [0, 1, 2].map((k) => pick(...corners.map((c) => Math.fround(c[k]))));
    view(start, 48, { componentType: 5126, count: 4, type: 'VEC3', min: bound(Math.min), max: bound(Math.max) });
    view(start + 48, 32, { componentType: 5126, count: 4, type: 'VEC2' });
    view(start + 80, 32, { componentType: 5126, count: 4, type: 'VEC2' });
});
view(4 * floats.length, 24, { componentType: 5125, count: 6, type: 'SCALAR' });

const gltf = {
    asset: { version: '2.0' }, extensionsUsed: ['KHR_materials_emissive_strength'], scene: 0,
    scenes: [{ nodes: [...quads, 0].map((_, n) => n) }],
    nodes: [...quads.slice(1).map((_, n) => ({ name: `quad ${n}`, mesh: n })), ...uses],
    meshes: quads.map(([, , , material], n) => ({ primitives: [{
        attributes: { POSITION: 3 * n, TEXCOORD_0: 3 * n + 1, TEXCOORD_1: 3 * n + 2 }, indices: 3 * quads.length,
        material
    }] })),
    materials: materials.map((m) => ({
        doubleSided: true,
        pbrMetallicRoughness: {
            baseColorFactor: [...m.color, 1], metallicFactor: 0, roughnessFactor: 1,
            ...(m.texture === undefined ? {} : { baseColorTexture: { index: m.texture } })
        },
        ...(m.cutoff ? { alphaMode: 'MASK', alphaCutoff: m.cutoff } : {}),
        ...(m.emission ? { emissiveFactor: [1, 1, 1],
            extensions: { KHR_materials_emissive_strength: { emissiveStrength: m.emission } } } : {})
    })),
    images: [{ uri: 'tiles.png' }, { uri: 'fence.png' }], samplers: [{}],
    textures: [{ source: 0, sampler: 0 }, { source: 1, sampler: 0 }], accessors, bufferViews: views,
    buffers: [{ uri: 'room.bin', byteLength: bin.length }]
};
fs.writeFileSync(`${folder}/tiles.png`, tiles);
fs.writeFileSync(`${folder}/fence.png`, fence);
fs.writeFileSync(`${folder}/room.bin`, bin);
fs.writeFileSync(`${folder}/room.gltf`, JSON.stringify(gltf));
