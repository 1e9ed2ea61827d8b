// For tests/test_unwrap.sh: makes scenes, and checks what sbl_unwrap has made of them. It shares no code with
// sbl_unwrap. usage: node unwrap.js make FOLDER | same|dense|apart|light|places|kept ARGUMENTS...
'use strict';
const fs = require('fs');
const path = require('path');
const assert = require('assert');

// ---- reading ----

const KINDS = { 5121: Uint8Array, 5123: Uint16Array, 5125: Uint32Array, 5126: Float32Array };
const SIZES = { SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4, MAT4: 16 };

function read(file) {
    const bytes = fs.readFileSync(file);
    if (bytes.toString('latin1', 0, 4) !== 'glTF') {
        const json = JSON.parse(bytes);
        return {
            json,
            buffers: (json.buffers || []).map((b) =>
                b.uri.startsWith('data:')
                    ? Buffer.from(b.uri.split(',')[1], 'base64')
                    : fs.readFileSync(path.join(path.dirname(file), b.uri))
            )
        };
    }
    const length = bytes.readUInt32LE(12);
    assert.strictEqual(bytes.readUInt32LE(8), bytes.length, 'the length of the .glb');
    return { json: JSON.parse(bytes.subarray(20, 20 + length)), buffers: [bytes.subarray(28 + length)] };
}

function values({ json, buffers }, i) {
    const a = json.accessors[i],
        v = json.bufferViews[a.bufferView],
        Kind = KINDS[a.componentType],
        n = SIZES[a.type];
    const out = [],
        step = v.byteStride || n * Kind.BYTES_PER_ELEMENT;
    for (let k = 0; k < a.count; k++) {
        const from = (v.byteOffset || 0) + (a.byteOffset || 0) + k * step;
        assert(
            k * step + n * Kind.BYTES_PER_ELEMENT + (a.byteOffset || 0) <= v.byteLength,
            `accessor ${i} is too long`
        );
        out.push([
            ...new Kind(new Uint8Array(buffers[v.buffer].subarray(from, from + n * Kind.BYTES_PER_ELEMENT)).buffer)
        ]);
    }
    return out;
}

function corners(scene, primitive) {
    if (primitive.indices !== undefined) return values(scene, primitive.indices).map(([i]) => i);
    return values(scene, primitive.attributes.POSITION).map((_, i) => i);
}

// Returns all triangles of all uses: { node, chart, p: three places in the world, t: three places in the map, 0 to 1 }.
function triangles(scene) {
    const out = [];
    for (const [node, n] of scene.json.nodes.entries()) {
        if (n.mesh === undefined) continue;
        const s = n.scale || [1, 1, 1],
            t = n.translation || [0, 0, 0];
        const [su, sv, ou, ov] = (n.extras && n.extras.lightmapScaleOffset) || [1, 1, 0, 0];
        for (const primitive of scene.json.meshes[n.mesh].primitives) {
            if (primitive.mode < 4) continue;
            const p = values(scene, primitive.attributes.POSITION),
                uv = values(scene, primitive.attributes.TEXCOORD_1);
            const list = corners(scene, primitive);
            for (let i = 0; i < list.length; i += 3)
                out.push({
                    node,
                    map: (n.extras || {}).lightmapIndex || 0,
                    vertices: list.slice(i, i + 3).map((v) => `${node} ${uv[v]}`),
                    p: list.slice(i, i + 3).map((v) => p[v].map((x, k) => x * s[k] + t[k])),
                    t: list.slice(i, i + 3).map((v) => [uv[v][0] * su + ou, uv[v][1] * sv + ov])
                });
        }
    }
    return out;
}

const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const minus = (a, b) => a.map((x, k) => x - b[k]);
const normal = ({ p }) => cross(minus(p[1], p[0]), minus(p[2], p[0]));
const area3 = (t) => Math.hypot(...normal(t)) / 2;
const turn = (a, b, c) => (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
const area2 = ({ t: [a, b, c] }) => Math.abs(turn(a, b, c)) / 2;

// Calls visit(x, y) for each texel whose centre is in a triangle, edges excluded.
function texels({ t }, size, visit) {
    const [a, b, c] = t.map(([u, v]) => [u * size, v * size]),
        sign = Math.sign(turn(a, b, c));
    for (let y = 0; y < size; y++) {
        if (y + 0.5 < Math.min(a[1], b[1], c[1]) || y + 0.5 > Math.max(a[1], b[1], c[1])) continue;
        for (let x = 0; x < size; x++) {
            const q = [x + 0.5, y + 0.5];
            if (Math.min(sign * turn(a, b, q), sign * turn(b, c, q), sign * turn(c, a, q)) > 1e-3) visit(x, y);
        }
    }
}

// ---- checks ----

const checks = {
    // apart FILE SIZE GAP LEAST: no texel shows two triangles, other charts are farther than GAP texels, and at least
    // LEAST percent of the map are filled
    apart(file, size, gap, least) {
        const all = triangles(read(file)),
            maps = 1 + Math.max(...all.map((t) => t.map)),
            chart = new Map();
        const root = (k) => {
            while (chart.has(k) && chart.get(k) !== k) k = chart.get(k);
            return k;
        };
        for (const { vertices, t } of all) {
            for (const [u, v] of t) assert(u >= 0 && u <= 1 && v >= 0 && v <= 1, `outside of the map: ${u} ${v}`);
            for (const k of vertices) if (!chart.has(k)) chart.set(k, k);
            for (const k of vertices) chart.set(root(k), root(vertices[0]));
        }
        let filled = 0;
        for (let map = 0; map < maps; map++) {
            const owner = new Array(size * size).fill(null);
            for (const t of all.filter((t) => t.map === map))
                texels(t, size, (x, y) => {
                    assert(!owner[y * size + x], `texel ${x} ${y} shows two triangles`);
                    owner[y * size + x] = root(t.vertices[0]);
                    filled++;
                });
            for (let y = 0; y < size; y++)
                for (let x = 0; x < size; x++)
                    for (let dy = -gap; dy <= gap && owner[y * size + x]; dy++)
                        for (let dx = -gap; dx <= gap; dx++) {
                            const other = x + dx >= 0 && x + dx < size && (owner[(y + dy) * size + x + dx] || null);
                            assert(!other || other === owner[y * size + x], `charts are near at ${x} ${y}`);
                        }
        }
        console.log(`filled: ${((100 * filled) / maps / size / size).toFixed(1)} %, ${maps} maps`);
        assert(filled >= (least / 100) * maps * size * size, 'too little is filled');
    },

    // dense FILE SIZE DENSITY: large triangles have this many texels for a unit of length, within 5 %
    dense(file, size, density) {
        let count = 0;
        for (const t of triangles(read(file))) {
            const own = area2(t) * size * size;
            if (own < 50) continue;
            const found = Math.sqrt(own / area3(t));
            assert(Math.abs(found / density - 1) < 0.05, `${found} texels for a unit of length, not ${density}`);
            count++;
        }
        assert(count > 4, `only ${count} triangles are large`);
    },

    // same BEFORE AFTER: all that a scene says is unchanged, except for the second coordinates
    same(before, after) {
        const scenes = [read(before), read(after)],
            shown = scenes.map((scene) => {
                const json = JSON.parse(JSON.stringify(scene.json));
                for (const key of ['accessors', 'bufferViews', 'buffers']) delete json[key];
                for (const n of json.nodes) {
                    for (const key of ['lightmapScaleOffset', 'lightmapIndex']) if (n.extras) delete n.extras[key];
                    if (n.extras && !Object.keys(n.extras).length) delete n.extras;
                }
                for (const [m, mesh] of json.meshes.entries())
                    for (const [k, primitive] of mesh.primitives.entries()) {
                        const own = scene.json.meshes[m].primitives[k],
                            list = corners(scene, own);
                        const sets = [own.attributes, ...(own.targets || [])].map((set) =>
                            Object.fromEntries(
                                Object.entries(set)
                                    .filter(
                                        ([key]) =>
                                            key !== 'TEXCOORD_1' &&
                                            (key !== 'TEXCOORD_0' ||
                                                read(before).json.meshes[m].primitives[k].attributes.TEXCOORD_0 !==
                                                    undefined)
                                    )
                                    .map(([key, i]) => [
                                        key,
                                        {
                                            ...scene.json.accessors[i],
                                            bufferView: 0,
                                            byteOffset: 0,
                                            sparse: 0,
                                            count: 0
                                        },
                                        own.mode < 4 ? values(scene, i) : list.map((v) => values(scene, i)[v])
                                    ])
                                    .map(([key, ...rest]) => [key, rest])
                            )
                        );
                        delete primitive.indices;
                        delete primitive.attributes;
                        delete primitive.targets;
                        primitive.sets = sets;
                    }
                for (const animation of json.animations || [])
                    for (const s of animation.samplers)
                        [s.input, s.output] = [values(scene, s.input), values(scene, s.output)];
                return json;
            });
        assert.deepStrictEqual(shown[1], shown[0]);
    },

    // places FILE NAME...: these nodes share a mesh, and each has a place; others have none
    places(file, ...names) {
        const { json } = read(file),
            placed = json.nodes.filter((n) => n.extras && n.extras.lightmapScaleOffset);
        assert.deepStrictEqual(placed.map((n) => n.name).sort(), names.sort());
        assert(
            placed.every((n) => n.mesh === placed[0].mesh) &&
                new Set(placed.map((n) => `${n.extras.lightmapScaleOffset}`)).size === names.length,
            'the places are equal'
        );
    },

    // maps FILE LEAST: there are at least so many maps, each named by a node
    maps(file, least) {
        const used = new Set(triangles(read(file)).map((t) => t.map));
        for (let map = 0; map < Math.max(...used); map++) assert(used.has(map), `no mesh is in map ${map}`);
        assert(used.size >= least, `${used.size} maps`);
    },

    // kept BEFORE AFTER: no mesh has other coordinates than before
    kept(before, after) {
        const [a, b] = [triangles(read(before)), triangles(read(after))];
        assert.deepStrictEqual(
            b.map((t) => t.vertices),
            a.map((t) => t.vertices)
        );
    },

    // light FILE FOLDER SIZE NAME R ...: R in the map on the faces of a node that point up
    light(file, folder, size, ...expected) {
        const bytes = fs.readFileSync(path.join(folder, 'lightmap.pfm')),
            at = bytes.length - 12 * size * size;
        const scene = read(file),
            all = triangles(scene);
        for (let k = 0; k < expected.length; k += 2) {
            const node = scene.json.nodes.findIndex((n) => n.name === expected[k]);
            let sum = 0,
                count = 0;
            for (const t of all.filter((t) => t.node === node && normal(t)[1] > 0.9 * Math.hypot(...normal(t))))
                texels(t, size, (x, y) => {
                    sum += bytes.readFloatLE(at + 12 * ((size - 1 - y) * size + x));
                    count++;
                });
            const mean = sum / count;
            console.log(`${expected[k]}: R = ${mean} in ${count} texels`);
            assert(
                count > 20 && Math.abs(mean - expected[k + 1]) < 0.02 * 3.2,
                `${expected[k]} has R = ${mean}, not ${expected[k + 1]}`
            );
        }
    }
};

// ---- scenes ----

class Maker {
    constructor() {
        this.pieces = [];
        this.at = 0;
        this.json = { asset: { version: '2.0', generator: 'test' }, accessors: [], bufferViews: [] };
    }
    add(array, type, more, view) {
        const bytes = Buffer.from(array.buffer);
        this.json.bufferViews.push({ buffer: 0, byteOffset: this.at, byteLength: bytes.length, ...view });
        const componentType = Number(Object.keys(KINDS).find((k) => array instanceof KINDS[k]));
        this.json.accessors.push({
            bufferView: this.json.bufferViews.length - 1,
            componentType,
            type,
            count: array.length / SIZES[type],
            ...more
        });
        this.pieces.push(bytes, Buffer.alloc((4 - (bytes.length % 4)) % 4));
        this.at += Math.ceil(bytes.length / 4) * 4;
        return this.json.accessors.length - 1;
    }
    write(file) {
        const name = path.basename(file).replace('.gltf', '.bin');
        fs.writeFileSync(path.join(path.dirname(file), name), Buffer.concat(this.pieces));
        this.json.buffers = [{ uri: name, byteLength: this.at, name: 'the buffer' }];
        fs.writeFileSync(file, JSON.stringify(this.json));
    }
}

// A box from 0 to 1: its faces have corners of their own. shared: corners are shared, without normals.
function box(maker, shared) {
    const places = [],
        normals = [],
        list = [];
    for (let axis = 0; axis < 3; axis++)
        for (const side of [0, 1]) {
            const first = places.length / 3,
                [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
            for (const [a, b] of [
                [0, 0],
                [1, 0],
                [1, 1],
                [0, 1]
            ]) {
                const p = [0, 0, 0],
                    n = [0, 0, 0];
                [p[axis], p[u], p[v], n[axis]] = [side, a, b, 2 * side - 1];
                places.push(...p);
                normals.push(...n);
            }
            list.push(...(side ? [0, 1, 2, 0, 2, 3] : [0, 2, 1, 0, 3, 2]).map((i) => first + i));
        }
    if (shared) {
        const corner = [0, 1, 2, 3, 4, 5, 6, 7].flatMap((i) => [i & 1, (i >> 1) & 1, i >> 2]);
        const number = (i) => places[3 * i] + 2 * places[3 * i + 1] + 4 * places[3 * i + 2];
        return {
            attributes: {
                POSITION: maker.add(
                    Float32Array.from(corner),
                    'VEC3',
                    { min: [0, 0, 0], max: [1, 1, 1] },
                    { target: 34962 }
                ),
                _HEAT: maker.add(
                    Float32Array.from({ length: 8 }, (_, i) => i),
                    'SCALAR'
                )
            },
            indices: maker.add(Uint8Array.from(list.map(number)), 'SCALAR', { max: [7] }, { target: 34963 })
        };
    }
    return {
        attributes: {
            POSITION: maker.add(Float32Array.from(places), 'VEC3', { min: [0, 0, 0], max: [1, 1, 1] }),
            NORMAL: maker.add(Float32Array.from(normals), 'VEC3')
        },
        indices: maker.add(Uint16Array.from(list), 'SCALAR')
    };
}

// Two boxes of one mesh, the second twice as large and below a roof; a sun shines from above. A mesh with shared
// corners, a morph target, an animation, a line, and unknown things.
function rich(folder) {
    const maker = new Maker(),
        { json } = maker,
        target = new Float32Array(24).fill(0.25);
    const soft = box(maker, true),
        line = maker.add(Float32Array.of(0, 0, 0, 1, 1, 1), 'VEC3', { min: [0, 0, 0], max: [1, 1, 1] });
    soft.targets = [
        { POSITION: maker.add(target, 'VEC3', { min: [0.25, 0.25, 0.25], max: [0.25, 0.25, 0.25], name: 'a target' }) }
    ];
    soft.material = 1;
    soft.extensions = { EXT_unknown: { mappings: [1, 2] } };
    json.meshes = [
        { name: 'crate', primitives: [{ ...box(maker), material: 0 }], extras: { price: 3 } },
        { name: 'soft', primitives: [soft, { attributes: { POSITION: line }, mode: 1 }], weights: [0] },
        { name: 'roof', primitives: [{ ...box(maker), material: 0 }] }
    ];
    json.materials = [
        {
            name: 'wood',
            pbrMetallicRoughness: { baseColorFactor: [0.5, 0.5, 0.5, 1], metallicFactor: 0, roughnessFactor: 1 }
        },
        { name: 'lack', pbrMetallicRoughness: { metallicFactor: 0, roughnessFactor: 0.2503 }, extras: { n: 1e-7 } }
    ];
    json.cameras = [{ type: 'perspective', perspective: { yfov: 0.7, znear: 0.01 }, name: 'eye' }];
    json.extensionsUsed = ['KHR_lights_punctual', 'EXT_unknown'];
    json.extensions = {
        KHR_lights_punctual: { lights: [{ type: 'directional', intensity: 10, name: 'sun' }] },
        EXT_unknown: { a: [] }
    };
    json.nodes = [
        { name: 'one', mesh: 0, translation: [-3, 0, 0], extras: { keep: 'me' } },
        { name: 'two', mesh: 0, translation: [2, 0, 0], scale: [2, 2, 2] },
        { name: 'soft', mesh: 1, translation: [-3, 0, 6] },
        { name: 'roof', mesh: 2, translation: [1, 4, -1], scale: [4, 0.1, 4] },
        {
            name: 'sun',
            rotation: [-Math.SQRT1_2, 0, 0, Math.SQRT1_2],
            extensions: { KHR_lights_punctual: { light: 0 } }
        },
        { name: 'eye', camera: 0, translation: [0, 3, 12] }
    ];
    json.scenes = [{ nodes: [0, 1, 2, 3, 4, 5], name: 'all' }];
    json.scene = 0;
    json.animations = [
        {
            name: 'sway',
            samplers: [
                {
                    input: maker.add(Float32Array.of(0, 1), 'SCALAR', { min: [0], max: [1] }),
                    output: maker.add(Float32Array.of(0, 3, 12, 1, 3, 12), 'VEC3')
                }
            ],
            channels: [{ sampler: 0, target: { node: 5, path: 'translation' } }]
        }
    ];
    maker.write(path.join(folder, 'rich.gltf'));
}

// Broken variants of a triangle; each is one change.
function broken(folder) {
    const base = () => {
        const maker = new Maker();
        maker.json.meshes = [
            {
                primitives: [
                    {
                        attributes: { POSITION: maker.add(Float32Array.of(0, 0, 0, 1, 0, 0, 0, 1, 0), 'VEC3') },
                        indices: maker.add(Uint16Array.of(0, 1, 2), 'SCALAR')
                    }
                ]
            }
        ];
        maker.json.nodes = [{ mesh: 0 }];
        return maker;
    };
    const changes = {
        index: (m) => {
            m.pieces[2] = Buffer.from([0, 0, 1, 0, 9, 0]);
        },
        nan: (m) => {
            m.pieces[0].writeFloatLE(NaN, 4);
        },
        accessor: (m) => {
            m.json.meshes[0].primitives[0].attributes.POSITION = 7;
        },
        count: (m) => {
            m.json.accessors[0].count = 4e9;
        },
        long: (m) => {
            m.json.accessors[0].count = 300;
        },
        view: (m) => {
            m.json.bufferViews[0].byteOffset = 1e6;
        },
        stride: (m) => {
            m.json.bufferViews[0].byteStride = 1e9;
        },
        sparse: (m) => {
            m.json.accessors[0].sparse = {
                count: 1,
                indices: { bufferView: 1, componentType: 5123, byteOffset: 4 },
                values: { bufferView: 5 }
            };
        },
        loop: (m) => {
            m.json.nodes = [{ children: [1] }, { mesh: 0, children: [0] }];
            m.json.scenes = [{ nodes: [0] }];
        },
        draco: (m) => {
            m.json.meshes[0].primitives[0].extensions = {
                KHR_draco_mesh_compression: { bufferView: 0, attributes: {} }
            };
        },
        meshopt: (m) => {
            m.json.bufferViews[0].extensions = { EXT_meshopt_compression: { buffer: 0 } };
        },
        flat: (m) => {
            m.pieces[0] = Buffer.alloc(36);
        },
        type: (m) => {
            m.json.accessors[0].type = 'VEC2';
        },
        nodes: (m) => {
            m.json.nodes = 5;
        },
        pair: (m) => {
            m.json.accessors[1].count = 2;
        }
    };
    for (const [name, change] of Object.entries(changes)) {
        const maker = base();
        change(maker);
        maker.write(path.join(folder, `${name}.gltf`));
    }
    const whole = base();
    whole.write(path.join(folder, 'short.gltf'));
    fs.truncateSync(path.join(folder, 'short.bin'), 20);
    whole.write(path.join(folder, 'outside.gltf'));
    const text = fs.readFileSync(path.join(folder, 'outside.gltf'), 'utf8');
    fs.writeFileSync(path.join(folder, 'outside.gltf'), text.replace('outside.bin', '%2e%2e/secret.bin'));
    fs.writeFileSync(path.join(folder, 'cut.gltf'), text.slice(0, 99));
    fs.writeFileSync(path.join(folder, 'cut.glb'), Buffer.from('glTF\x02\0\0\0\xff\0\0\0\xff\0\0\0JSON{}', 'latin1'));
    fs.writeFileSync(path.join(folder, 'empty.gltf'), '');
}

// A square with a second UV set, whose triangles overlap if `overlaps`; it is bare of a first set.
function square(folder, name, uv) {
    const maker = new Maker();
    maker.json.meshes = [
        {
            name: 'square',
            primitives: [
                {
                    attributes: {
                        POSITION: maker.add(Float32Array.of(0, 0, 0, 1, 0, 0, 1, 0, -1, 0, 0, -1), 'VEC3', {
                            min: [0, 0, -1],
                            max: [1, 0, 0]
                        }),
                        TEXCOORD_1: maker.add(Float32Array.from(uv), 'VEC2')
                    },
                    indices: maker.add(Uint16Array.of(0, 1, 2, 0, 2, 3), 'SCALAR')
                }
            ]
        }
    ];
    maker.json.nodes = [{ mesh: 0, name: 'square' }];
    maker.write(path.join(folder, name));
}

const [what, ...words] = process.argv.slice(2),
    numbers = words.map((w) => (w === '' || isNaN(w) ? w : Number(w)));
if (what === 'make') {
    const folder = words[0];
    rich(folder);
    square(folder, 'usable.gltf', [0, 0, 1, 0, 1, 1, 0, 1]);
    square(folder, 'overlaps.gltf', [0, 0, 1, 0, 1, 1, 1, 0]);
    square(folder, 'beyond.gltf', [0, 0, 2, 0, 2, 1, 0, 1]);
    fs.mkdirSync(path.join(folder, 'broken'));
    broken(path.join(folder, 'broken'));
} else checks[what](...numbers);
