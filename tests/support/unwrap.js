// For tests/test_unwrap.sh: makes scenes, and checks the results of sbl_unwrap. It shares no code with sbl_unwrap.
// usage: node unwrap.js make FOLDER | bakes FOLDER FROM MIXED | refuses FOLDER |
// same|dense|wide|apart|light|lit|places|kept ARGUMENTS...
'use strict';
const fs = require('fs');
const path = require('path');
const assert = require('assert');

// ---- reading scenes ----

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

function list(scene, source, type, count, Kind) {
    const v = scene.json.bufferViews[source.bufferView], n = SIZES[type], out = [], bytes = n * Kind.BYTES_PER_ELEMENT;
    for (let k = 0; k < count; k++) {
        const at = (source.byteOffset || 0) + k * (v.byteStride || bytes), from = (v.byteOffset || 0) + at;
        assert(at + bytes <= v.byteLength, 'an accessor is longer than its view');
        out.push([...new Kind(new Uint8Array(scene.buffers[v.buffer].subarray(from, from + bytes)).buffer)]);
    }
    return out;
}

function values(scene, i) {
    const a = scene.json.accessors[i], Kind = KINDS[a.componentType];
    const out = a.bufferView === undefined ? Array.from({ length: a.count }, () => new Array(SIZES[a.type]).fill(0))
                                           : list(scene, a, a.type, a.count, Kind);
    if (!a.sparse) return out;
    const at = list(scene, a.sparse.indices, 'SCALAR', a.sparse.count, KINDS[a.sparse.indices.componentType]);
    list(scene, a.sparse.values, a.type, a.sparse.count, Kind).forEach((v, k) => { out[at[k][0]] = v; });
    return out;
}

function corners(scene, primitive) {
    const all = primitive.indices !== undefined ? values(scene, primitive.indices).map(([i]) => i)
                                                : values(scene, primitive.attributes.POSITION).map((_, i) => i);
    const faces = all.slice(2).map((_, i) => i);
    if (primitive.mode === 5) return faces.flatMap((i) => [all[i], all[i + 1 + i % 2], all[i + 2 - i % 2]]);
    if (primitive.mode === 6) return faces.flatMap((i) => [all[i + 1], all[i + 2], all[0]]);
    return all;
}

// Returns the triangles of all uses of meshes: { node, chart, p: three positions in the world, t: three points in the
// map, 0 to 1 }.
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
                set = primitive.attributes.TEXCOORD_1,
                uv = set === undefined ? p : values(scene, set);
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

// Calls visit(x, y) for each texel whose centre is strictly inside a triangle.
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

// Returns the content of a scene, with the elements of accessors in their place, but without second coordinates. has:
// function that returns true if a primitive had a first set originally
function plain(scene, has) {
    const json = JSON.parse(JSON.stringify(scene.json));
    for (const key of ['accessors', 'bufferViews', 'buffers']) delete json[key];
    if (json.asset.extras) delete json.asset.extras.lightmapSize;
    if (json.asset.extras && !Object.keys(json.asset.extras).length) delete json.asset.extras;
    for (const n of json.nodes) {
        for (const key of ['lightmapScaleOffset', 'lightmapIndex']) if (n.extras) delete n.extras[key];
        if (n.extras && !Object.keys(n.extras).length) delete n.extras;
    }
    const shown = (i, all) => {
        const list = values(scene, i), a = scene.json.accessors[i];
        return [{ ...a, bufferView: 0, byteOffset: 0, sparse: 0, count: 0 }, all ? all.map((v) => list[v]) : list];
    };
    for (const [m, mesh] of json.meshes.entries())
        for (const [k, primitive] of mesh.primitives.entries()) {
            const own = scene.json.meshes[m].primitives[k], all = own.mode < 4 ? null : corners(scene, own);
            const isKept = (key) => key !== 'TEXCOORD_1' && (key !== 'TEXCOORD_0' || has(m, k));
            for (const key of ['indices', 'attributes', 'targets']) delete primitive[key];
            primitive.sets = [own.attributes, ...(own.targets || [])].map((set) => Object.fromEntries(
                Object.entries(set).filter(([key]) => isKept(key)).map(([key, i]) => [key, shown(i, all)])));
        }
    for (const animation of json.animations || [])
        for (const sampler of animation.samplers)
            for (const key of ['input', 'output']) sampler[key] = values(scene, sampler[key]);
    return json;
}

// Returns the content of a scene, with the bytes of buffer views in their place, but without the additions of --light:
// the last images, textures, samplers and extensions (`added` of each), and copies of meshes and materials. count:
// number of meshes and materials of the scene before
function unlit(scene, count, added) {
    const json = JSON.parse(JSON.stringify(scene.json)), extensions = (m) => ({ ...m, extensions: m.extensions || {} });
    delete json.buffers;
    json.bufferViews = json.bufferViews.map(({ buffer, byteOffset = 0, ...view }) =>
        ({ ...view, bytes: scene.buffers[buffer].subarray(byteOffset, byteOffset + view.byteLength).toString('hex') }));
    json.materials = json.materials.map(extensions);
    for (const { extensions } of json.materials) delete extensions.MOZ_lightmap;
    const shown = (owner) => ({ ...owner, material: json.materials[owner.material] || { extensions: {} } });
    for (const mesh of json.meshes)
        for (const primitive of mesh.primitives) {
            const { mappings } = (primitive.extensions || {}).KHR_materials_variants || {};
            if (mappings) primitive.extensions.KHR_materials_variants.mappings = mappings.map(shown);
            Object.assign(primitive, shown(primitive));
        }
    for (const node of json.nodes) if (node.mesh !== undefined) node.mesh = json.meshes[node.mesh];
    json.meshes.length = count.meshes;
    json.materials.length = count.materials;
    json.extensionsUsed.length -= added.extensions || 0;
    for (const key of ['images', 'samplers', 'textures'])
        if ((json[key] || []).length > (added[key] || 0)) json[key].length -= added[key] || 0;
        else delete json[key];
    json.bufferViews.length -= added.views || 0;
    return json;
}

// Returns the bytes of a picture in a folder of sbl_bake, and its intensity according to scene.gltf.
function atlasOf(folder, name) {
    const { json } = read(path.join(folder, 'scene.gltf'));
    const isOwn = (info) => info && json.images[json.textures[info.index].source].uri === name;
    const infos = json.materials.map((m) => m.extensions && m.extensions.MOZ_lightmap).filter(isOwn);
    assert(infos.length, `no material has ${name}`);
    return { png: fs.readFileSync(path.join(folder, name)), intensity: infos[0].intensity };
}

// Returns the bytes of an image of a scene.
function pictureOf(scene, file, number) {
    const { uri, bufferView } = scene.json.images[number];
    if (uri !== undefined) return fs.readFileSync(path.join(path.dirname(file), decodeURIComponent(uri)));
    const { byteOffset = 0, byteLength } = scene.json.bufferViews[bufferView];
    return scene.buffers[0].subarray(byteOffset, byteOffset + byteLength);
}

// ---- checks ----

const checks = {
    // apart FILE SIZE GAP LEAST: no texel shows two triangles, different charts are more than GAP texels apart, and at
    // least LEAST percent of the map are filled
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

    // dense FILE SIZE DENSITY: large triangles have this many texels per unit of length, within 3 %
    dense(file, size, density) {
        let count = 0;
        for (const t of triangles(read(file))) {
            const own = area2(t) * size * size;
            if (own < 50) continue;
            const found = Math.sqrt(own / area3(t));
            assert(Math.abs(found / density - 1) < 0.03, `${found} texels for a unit of length, not ${density}`);
            count++;
        }
        assert(count > 4, `only ${count} triangles are large`);
    },

    // wide FILE SIZE LEAST: the bounding rectangles of all triangles have sides of at least LEAST texels
    wide(file, size, least) {
        for (const { t } of triangles(read(file)))
            for (const k of [0, 1]) {
                const all = t.map((v) => v[k] * size), side = Math.max(...all) - Math.min(...all);
                assert(side > least - 0.01, `a triangle is ${side} texels wide`);
            }
    },

    // parted FILE SIZE COUNT: this many edges have two places in the map, through the centres of neighbouring texels
    parted(file, size, count) {
        const places = new Map();
        for (const { p, t } of triangles(read(file)))
            for (let k = 0; k < 3; k++) {
                const ends = [k, (k + 1) % 3].map((i) => ({ key: `${p[i]}`, at: t[i].map((x) => x * size) }));
                ends.sort((a, b) => (a.key < b.key ? -1 : 1));
                const key = ends.map((e) => e.key).join(), at = ends.map((e) => e.at);
                if (!places.has(key)) places.set(key, []);
                if (!places.get(key).some((other) => `${other}` === `${at}`)) places.get(key).push(at);
            }
        const cut = [...places.values()].filter((list) => list.length > 1);
        assert.strictEqual(cut.length, count, 'number of parted edges');
        for (const [one, other] of cut)
            for (const end of [0, 1]) {
                const apart = [0, 1].map((k) => Math.abs(one[end][k] - other[end][k]));
                const axis = apart[0] > apart[1] ? 0 : 1;
                const fraction = one[end][axis] - Math.floor(one[end][axis]);
                assert(Math.abs(apart[axis] - 1) < 0.01 && apart[1 - axis] < 0.01, `${apart} texels apart`);
                assert(Math.abs(fraction - 0.5) < 0.01, `an edge is at ${one[end][axis]}`);
            }
    },

    // same BEFORE AFTER: the content of a scene is unchanged, except for the second coordinates
    same(before, after) {
        const old = read(before), has = (m, k) => old.json.meshes[m].primitives[k].attributes.TEXCOORD_0 !== undefined;
        assert.deepStrictEqual(plain(read(after), has), plain(old, has));
    },

    // foreign BEFORE AFTER: the accessor that extension EXT_unknown names has the same content
    foreign(before, after) {
        const [old, scene] = [before, after].map(read), i = old.json.extensions.EXT_unknown.accessor;
        assert.deepStrictEqual(values(scene, i), values(old, i));
    },

    // lit BEFORE AFTER FOLDER MAPS MESHES MATERIALS: AFTER equals BEFORE plus the maps in FOLDER, such as 0 or 0,1, on
    // all surfaces of these maps and on no others. MESHES and MATERIALS are the numbers of new ones. Other nodes keep
    // their meshes
    lit(before, after, folder, list, meshes, materials) {
        const old = read(before), scene = read(after), { json } = scene, isBinary = after.endsWith('.glb');
        const isNew = (name) => +!(old.json.extensionsUsed || []).includes(name);
        const maps = `${list}`.split(',').map(Number);
        const added = { extensions: isNew('MOZ_lightmap') + isNew('KHR_texture_transform'), images: maps.length,
                        textures: maps.length, samplers: isNew('MOZ_lightmap'), views: isBinary ? maps.length : 0 };
        const count = { meshes: old.json.meshes.length, materials: old.json.materials.length };
        assert.deepStrictEqual(unlit(scene, count, added), unlit(old, count, {}));
        assert.strictEqual(json.meshes.length, count.meshes + meshes, 'meshes');
        assert.strictEqual(json.materials.length, count.materials + materials, 'materials');
        const infos = maps.map((map, k) => {
            const index = json.textures.length - maps.length + k, { source } = json.textures[index];
            assert.strictEqual(source, json.images.length - maps.length + k);
            const { png, intensity } = atlasOf(folder, maps.length > 1 ? `atlas_${map}.png` : 'atlas.png');
            assert(pictureOf(scene, after, source).equals(png), 'the picture');
            return { index, texCoord: 1, intensity };
        });
        const none = { mappings: [] }, shown = new Set(json.scenes[json.scene || 0].nodes);
        for (const [i, node] of json.nodes.entries()) {
            const { lightmapScaleOffset: place, lightmapIndex = 0 } = node.extras || {};
            const move = place && { scale: place.slice(0, 2), offset: place.slice(2) };
            const info = infos[maps.indexOf(lightmapIndex)];
            if (!shown.has(i) || !info) assert.strictEqual(node.mesh, old.json.nodes[i].mesh, node.name);
            const expected = { ...info, ...(move ? { extensions: { KHR_texture_transform: move } } : {}) };
            for (const p of node.mesh === undefined ? [] : json.meshes[node.mesh].primitives)
                for (const { material } of [p, ...((p.extensions || {}).KHR_materials_variants || none).mappings]) {
                    const has = ((json.materials[material] || {}).extensions || {}).MOZ_lightmap;
                    const isLit = shown.has(i) && p.attributes.TEXCOORD_1 !== undefined && !(p.mode < 4);
                    if (isLit && info) assert.deepStrictEqual(has, expected, node.name);
                    else assert(!has || (!info && has.index < infos[0].index), `${node.name} has light`);
                }
        }
    },

    // relit BEFORE AFTER FOLDER: the maps in FOLDER have replaced those of BEFORE, and nothing else is new
    relit(before, after, folder) {
        const old = read(before), scene = read(after), isBinary = after.endsWith('.glb');
        const plain = ({ json }) => {
            const copy = JSON.parse(JSON.stringify({ ...json, buffers: 0 }));
            copy.bufferViews = copy.bufferViews.filter((_, i) => !copy.images.some((m) => m.bufferView === i));
            for (const view of copy.bufferViews) delete view.byteOffset, delete view.byteLength;
            for (const image of copy.images) delete image.bufferView, delete image.uri;
            for (const { extensions = {} } of copy.materials)
                if (extensions.MOZ_lightmap) extensions.MOZ_lightmap.intensity = 0;
            return copy;
        };
        assert.deepStrictEqual(plain(scene), plain(old));
        const sum = (views) => views.reduce((all, v) => all + Math.ceil(v.byteLength / 4) * 4, 0);
        if (isBinary) assert.strictEqual(sum(scene.json.bufferViews), scene.buffers[0].length);
        for (const { extensions = {} } of scene.json.materials) {
            if (!extensions.MOZ_lightmap) continue;
            const { source } = scene.json.textures[extensions.MOZ_lightmap.index];
            const name = scene.json.images[source].name.replace('lightmap', 'atlas');
            const { png, intensity } = atlasOf(folder, `${name}.png`);
            assert(pictureOf(scene, after, source).equals(png), name);
            assert.strictEqual(extensions.MOZ_lightmap.intensity, intensity);
        }
    },

    // table FOLDER SCENE SIZE: maps.json agrees with SCENE about each node, and scene.gltf and scene_lit.glb refer to
    // the same maps
    table(folder, file, size) {
        const table = JSON.parse(fs.readFileSync(path.join(folder, 'maps.json'))), { json } = read(file);
        assert.strictEqual(table.size, size);
        const placed = json.nodes.map((n, i) => [n, i]).filter(([n]) => n.mesh !== undefined &&
            json.meshes[n.mesh].primitives.some((p) => p.attributes.TEXCOORD_1 !== undefined && !(p.mode < 4)));
        assert.deepStrictEqual(table.nodes.map((n) => n.node), placed.map(([, i]) => i));
        for (const [k, [{ name, extras = {} }]] of placed.entries()) {
            const [su, sv, ou, ov] = (extras.lightmapScaleOffset || [1, 1, 0, 0]).map(Math.fround);
            const { scale, offset, map, name: own } = table.nodes[k];
            assert.deepStrictEqual([own, map], [name, extras.lightmapIndex || 0]);
            assert.deepStrictEqual([...scale, ...offset].map(Math.fround), [su, sv, ou, ov]);
        }
        for (const { atlas, png, intensity } of table.maps) {
            for (const one of atlas) assert(fs.existsSync(path.join(folder, one)), one);
            assert.strictEqual(atlasOf(folder, png).intensity, intensity);
        }
        const mapOf = new Map(table.nodes.map((n) => [n.name, n.map]));
        const baked = read(path.join(folder, 'scene.gltf')).json, shown = read(path.join(folder, 'scene_lit.glb')).json;
        for (const node of [...baked.nodes, ...shown.nodes]) {
            const all = baked.nodes.includes(node) ? baked : shown;
            const { extensions, pbrMetallicRoughness } = all.materials[all.meshes[node.mesh].primitives[0].material];
            const light = all === baked ? extensions.MOZ_lightmap : pbrMetallicRoughness.baseColorTexture;
            const texture = light && all.textures[light.index];
            if (!mapOf.has(node.name)) assert.strictEqual(light, undefined, node.name);
            else if (all === shown) assert.strictEqual(texture.source, mapOf.get(node.name), node.name);
            else assert.strictEqual(all.images[texture.source].uri, `atlas_${mapOf.get(node.name)}.png`, node.name);
        }
    },

    // one_set FILE: all meshes have one set of coordinates that is both the first and the second
    one_set(file) {
        for (const { primitives } of read(file).json.meshes)
            for (const { attributes: a } of primitives) assert.strictEqual(a.TEXCOORD_0, a.TEXCOORD_1);
    },

    // surface BEFORE AFTER: both have the same triangles in the same order
    surface(before, after) {
        const [a, b] = [before, after].map((name) => triangles(read(name)).map((t) => t.p));
        assert(a.length > 0);
        assert.deepStrictEqual(b, a);
    },

    // places FILE NAME...: these nodes share a mesh, and each has a scale and an offset in its extras; other nodes have
    // none
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

    // maps FILE LEAST: there are at least LEAST maps, and nodes use each
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

// ---- making scenes ----

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

const VIEW = { target: 34962 }, BOUNDS = { min: [0, 0, 0], max: [1, 1, 1] };

// A box from 0 to 1. shared: true: its faces share corners, which have no normals; false: each face has its own corners
function box(maker, shared) {
    const places = [], normals = [], all = [];
    for (let axis = 0; axis < 3; axis++)
        for (const side of [0, 1]) {
            const first = places.length / 3, u = (axis + 1) % 3, v = (axis + 2) % 3;
            for (let corner = 0; corner < 4; corner++) {
                const p = [0, 0, 0], n = [0, 0, 0];
                [p[axis], p[u], p[v], n[axis]] = [side, +(corner % 3 > 0), +(corner > 1), 2 * side - 1];
                places.push(...p);
                normals.push(...n);
            }
            all.push(...(side ? [0, 1, 2, 0, 2, 3] : [0, 2, 1, 0, 3, 2]).map((i) => first + i));
        }
    if (shared) {
        const corner = [0, 1, 2, 3, 4, 5, 6, 7].flatMap((i) => [i & 1, (i >> 1) & 1, i >> 2]);
        const number = (i) => places[3 * i] + 2 * places[3 * i + 1] + 4 * places[3 * i + 2];
        const heat = Float32Array.from({ length: 8 }, (_, i) => i);
        return { attributes: { POSITION: maker.add(Float32Array.from(corner), 'VEC3', BOUNDS, VIEW),
                               _HEAT: maker.add(heat, 'SCALAR'),
                               COLOR_0: maker.add(Uint8Array.from({ length: 24 }, (_, i) => 10 * i), 'VEC3',
                                                  { normalized: true }) },
                 indices: maker.add(Uint8Array.from(all.map(number)), 'SCALAR', { max: [7] }, { target: 34963 }) };
    }
    return { attributes: { POSITION: maker.add(Float32Array.from(places), 'VEC3', BOUNDS),
                           NORMAL: maker.add(Float32Array.from(normals), 'VEC3') },
             indices: maker.add(Uint16Array.from(all), 'SCALAR') };
}

// Returns an accessor of 8 vectors; the vector with the index 5 is (0, 0.25, 0), and the others are 0.
function sparse(maker) {
    const [indices, values] = [maker.add(Uint16Array.of(5), 'SCALAR'), maker.add(Float32Array.of(0, 0.25, 0), 'VEC3')]
        .map((i) => ({ bufferView: maker.json.accessors[i].bufferView }));
    maker.json.accessors.push({ componentType: 5126, type: 'VEC3', count: 8, name: 'a target', min: [0, 0, 0],
                                max: [0, 0.25, 0],
                                sparse: { count: 1, indices: { ...indices, componentType: 5123 }, values } });
    return maker.json.accessors.length - 1;
}

// Adds content that a scene may have besides meshes.
function things(maker, json) {
    const lights = [{ type: 'directional', intensity: 10, name: 'sun' }];
    const wood = { baseColorFactor: [0.5, 0.5, 0.5, 1], metallicFactor: 0, roughnessFactor: 1 };
    json.materials = [{ name: 'wood', pbrMetallicRoughness: wood },
                      { name: 'lacquer', pbrMetallicRoughness: { roughnessFactor: 0.2503 }, extras: { n: 1e-7 } }];
    json.cameras = [{ type: 'perspective', perspective: { yfov: 0.7, znear: 0.01 }, name: 'eye' }];
    json.extensionsUsed = ['KHR_lights_punctual', 'EXT_unknown'];
    json.extensions = { KHR_lights_punctual: { lights }, EXT_unknown: { a: [] } };
    const input = maker.add(Float32Array.of(0, 1), 'SCALAR', { min: [0], max: [1] });
    json.animations = [{ name: 'sway', samplers: [{ input,
                                                    output: maker.add(Float32Array.of(0, 3, 12, 1, 3, 12), 'VEC3') }],
                         channels: [{ sampler: 0, target: { node: 5, path: 'translation' } }] }];
}

// Two boxes of one mesh, the second twice as large and below a roof, in the light of a sun from above; a mesh with
// shared corners, a morph target, an animation, a line, and unknown content.
function rich(folder) {
    const maker = new Maker(), { json } = maker, soft = { ...box(maker, true), targets: [{ POSITION: sparse(maker) }] };
    const line = maker.add(Float32Array.of(0, 0, 0, 1, 1, 1), 'VEC3', BOUNDS);
    soft.material = 1;
    soft.extensions = { EXT_unknown: { mappings: [1, 2] } };
    json.meshes = [{ name: 'crate', primitives: [{ ...box(maker), material: 0 }], extras: { price: 3 } },
                   { name: 'soft', primitives: [soft, { attributes: { POSITION: line }, mode: 1 }], weights: [0] },
                   { name: 'roof', primitives: [{ ...box(maker), material: 0 }] }];
    things(maker, json);
    json.nodes = [{ name: 'one', mesh: 0, translation: [-3, 0, 0], extras: { keep: 'me' } },
                  { name: 'two', mesh: 0, translation: [2, 0, 0], scale: [2, 2, 2] },
                  { name: 'soft', mesh: 1, translation: [-3, 0, 6] },
                  { name: 'roof', mesh: 2, translation: [1, 4, -1], scale: [4, 0.1, 4] },
                  { name: 'sun', rotation: [-Math.SQRT1_2, 0, 0, Math.SQRT1_2],
                    extensions: { KHR_lights_punctual: { light: 0 } } },
                  { name: 'eye', camera: 0, translation: [0, 3, 12] }];
    json.scenes = [{ nodes: [0, 1, 2, 3, 4, 5], name: 'all' }];
    json.scene = 0;
    maker.write(path.join(folder, 'rich.gltf'));
}

// A strip, a fan and a list, without and with indices, that share vertices; only the sparse part of their accessor
// holds one of these. Also a triangle without area.
function odd(folder) {
    const maker = new Maker(), { json } = maker, places = [0, 0, 0, 1, 0, 0, 0, 1, 0, 9, 9, 9, 0, 2, 0, 1, 2, 1];
    const POSITION = maker.add(Float32Array.from(places), 'VEC3', { min: [0, 0, 0], max: [1, 2, 1] });
    const at = maker.add(Uint8Array.of(3), 'SCALAR'), to = maker.add(Float32Array.of(1, 1, 0), 'VEC3');
    const view = (i) => ({ bufferView: json.accessors[i].bufferView });
    json.accessors[POSITION].sparse = { count: 1, indices: { ...view(at), componentType: 5121 }, values: view(to) };
    const of = (mode, ...i) => ({ attributes: { POSITION }, mode, indices: maker.add(Uint8Array.from(i), 'SCALAR') });
    json.meshes = [{ primitives: [{ attributes: { POSITION }, mode: 5 }, of(6, 0, 2, 3, 1), of(4, 0, 1, 5, 0, 1, 1)] }];
    json.nodes = [{ mesh: 0 }];
    maker.write(path.join(folder, 'odd.gltf'));
}

// Each entry is one change that makes a good scene bad.
const unknown = { indices: { bufferView: 1, componentType: 5123, byteOffset: 4 }, values: { bufferView: 5 } };
const CHANGES = {
    index: (m) => { m.pieces[2] = Buffer.from([0, 0, 1, 0, 9, 0]); },
    nan: (m) => { m.pieces[0].writeFloatLE(NaN, 4); },
    accessor: (m) => { m.json.meshes[0].primitives[0].attributes.POSITION = 7; },
    count: (m) => { m.json.accessors[0].count = 4e9; },
    long: (m) => { m.json.accessors[0].count = 300; },
    view: (m) => { m.json.bufferViews[0].byteOffset = 1e6; },
    stride: (m) => { m.json.bufferViews[0].byteStride = 1e9; },
    sparse: (m) => { m.json.accessors[0].sparse = { count: 1, ...unknown }; },
    loop: (m) => {
        m.json.nodes = [{ children: [1] }, { mesh: 0, children: [0] }];
        m.json.scenes = [{ nodes: [0] }];
    },
    draco: (m) => { m.json.meshes[0].primitives[0].extensions = { KHR_draco_mesh_compression: {} }; },
    meshopt: (m) => { m.json.bufferViews[0].extensions = { EXT_meshopt_compression: { buffer: 0 } }; },
    flat: (m) => { m.pieces[0] = Buffer.alloc(36); },
    type: (m) => { m.json.accessors[0].type = 'VEC2'; },
    nodes: (m) => { m.json.nodes = 5; },
    primitives: (m) => { m.json.meshes[0].primitives = { length: 3 }; },
    attributes: (m) => { m.json.meshes[0].primitives[0].attributes = 'POSITION'; },
    child: (m) => { m.json.nodes[0].children = [1e9]; },
    huge: (m) => { m.json.nodes[0].scale = [1e300, 1e300, 1e300]; },
    pair: (m) => { m.json.accessors[1].count = 2; }
};

function broken(folder) {
    const base = () => {
        const maker = new Maker(), POSITION = maker.add(Float32Array.of(0, 0, 0, 1, 0, 0, 0, 1, 0), 'VEC3');
        const indices = maker.add(Uint16Array.of(0, 1, 2), 'SCALAR');
        maker.json.meshes = [{ primitives: [{ attributes: { POSITION }, indices }] }];
        maker.json.nodes = [{ mesh: 0 }];
        return maker;
    };
    for (const [name, change] of Object.entries(CHANGES)) {
        const maker = base();
        change(maker);
        maker.write(path.join(folder, `${name}.gltf`));
    }
    const write = (name, text) => fs.writeFileSync(path.join(folder, name), text);
    base().write(path.join(folder, 'short.gltf'));
    const text = fs.readFileSync(path.join(folder, 'short.gltf'), 'utf8');
    fs.truncateSync(path.join(folder, 'short.bin'), 20);
    write('outside.gltf', text.replace('short.bin', '%2e%2e/rich.bin'));
    write('absolute.gltf', text.replace('short.bin', path.resolve(folder, '../rich.bin')));
    fs.symlinkSync('../rich.bin', path.join(folder, 'link.bin'));
    write('linked.gltf', text.replace('short.bin', 'link.bin'));
    write('folder.gltf', text.replace('short.bin', '.'));
    write('remote.gltf', text.replace('short.bin', 'http://localhost/a.bin'));
    write('cut.gltf', text.slice(0, 99));
    write('cut.glb', Buffer.from('glTF\x02\0\0\0\xff\0\0\0\xff\0\0\0JSON{}', 'latin1'));
    write('empty.gltf', '');
    write('null.gltf', 'null');
    write('bad.obj', 'f 1 2 3\n');
}

// A square with a second UV set and without a first one.
function square(folder, name, uv) {
    const maker = new Maker(), { json } = maker, places = [0, 0, 0, 1, 0, 0, 1, 0, -1, 0, 0, -1];
    const POSITION = maker.add(Float32Array.from(places), 'VEC3', { min: [0, 0, -1], max: [1, 0, 0] });
    const attributes = { POSITION, TEXCOORD_1: maker.add(Float32Array.from(uv), 'VEC2') };
    const indices = maker.add(Uint16Array.of(0, 1, 2, 0, 2, 3), 'SCALAR');
    json.meshes = [{ name: 'square', primitives: [{ attributes, indices }] }];
    json.nodes = [{ mesh: 0, name: 'square' }];
    json.scenes = [{ nodes: [0] }];
    maker.write(path.join(folder, name));
    if (name !== 'usable.gltf') return;
    json.nodes.push({ mesh: 0, name: 'other', translation: [2, 0, 0], scale: [0.5, 0.5, 0.5] });
    json.scenes[0].nodes.push(1);
    maker.write(path.join(folder, 'usable_twice.gltf'));
}

// A square beside a band of the same length. profile: z, y of points across the band; each pair of neighbours makes a
// facet.
function band(folder, name, profile) {
    const maker = new Maker(), { json } = maker;
    const places = [0, 0, 0, 1, 0, 0, 1, 0, -1, 0, 0, -1], faces = [0, 1, 2, 0, 2, 3];
    for (const [k, [z, y]] of profile.entries()) {
        places.push(0, y, 3 - z, 1, y, 3 - z);
        const v = 4 + 2 * k;
        if (k + 1 < profile.length) faces.push(v, v + 1, v + 3, v, v + 3, v + 2);
    }
    const POSITION = maker.add(Float32Array.from(places), 'VEC3', { min: [0, 0, -1], max: [1, 1, 3] });
    const indices = maker.add(Uint16Array.from(faces), 'SCALAR');
    json.meshes = [{ primitives: [{ attributes: { POSITION }, indices }] }];
    json.nodes = [{ mesh: 0 }];
    maker.write(path.join(folder, name));
}

// Two squares of one mesh, with and without a scale and offset, another one in a second map, and one in a second scene;
// a square without a material, and one without second coordinates. A sun shines from above.
function mixed(folder) {
    const maker = new Maker(), { json } = maker, uv = Float32Array.of(0, 0, 0.5, 0, 0.5, 1, 0, 1);
    const places = Float32Array.of(0, 0, 0, 1, 0, 0, 1, 0, -1, 0, 0, -1), set = maker.add(uv, 'VEC2');
    const POSITION = maker.add(places, 'VEC3', { min: [0, 0, -1], max: [1, 0, 0] });
    const flat = { attributes: { POSITION, TEXCOORD_0: set } }, both = { ...flat.attributes, TEXCOORD_1: set };
    const half = (...i) => ({ attributes: both, indices: maker.add(Uint16Array.from(i), 'SCALAR'), material: 0 });
    const whole = maker.add(Uint16Array.of(0, 1, 2, 0, 2, 3), 'SCALAR');
    things(maker, json);
    json.extensionsUsed.push('KHR_materials_variants');
    json.extensions.KHR_materials_variants = { variants: [{ name: 'new' }] };
    const other = { extensions: { KHR_materials_variants: { mappings: [{ material: 1, variants: [0], name: 'm' }] } } };
    json.meshes = [{ name: 'tile', primitives: [{ ...half(0, 1, 2), ...other }, half(0, 2, 3)], extras: { a: 1 } },
                   { name: 'bare', primitives: [{ ...flat, indices: whole, material: 0 }] },
                   { name: 'raw', primitives: [{ attributes: both, indices: whole }] }];
    const place = (v) => [1, 0.4, 0.5, v], sun = { extensions: { KHR_lights_punctual: { light: 0 } } };
    json.nodes = [{ name: 'plain', mesh: 0 },
                  { name: 'placed', mesh: 0, extras: { lightmapScaleOffset: place(0), more: [1] } },
                  { name: 'raw', mesh: 2, extras: { lightmapScaleOffset: place(0.5) } },
                  { name: 'next map', mesh: 0, extras: { lightmapScaleOffset: [2, 1, 0, 0], lightmapIndex: 1 } },
                  { name: 'bare', mesh: 1 }, { name: 'eye', camera: 0 },
                  { name: 'sun', rotation: [-Math.SQRT1_2, 0, 0, Math.SQRT1_2], ...sun },
                  { name: 'elsewhere', mesh: 0 }].map((n, i) => ({ ...n, translation: [2 * i, 0, 0] }));
    json.scenes = [{ nodes: [0, 1, 2, 3, 4, 5, 6] }, { nodes: [7], name: 'second' }];
    json.scene = 0;
    maker.write(path.join(folder, 'mixed.gltf'));
}

// Each entry is one change that makes mixed.gltf bad.
const MIXED = {
    place: (j) => { j.nodes[1].extras.lightmapScaleOffset = [1, 1, '0', 0]; },
    four: (j) => { j.nodes[1].extras.lightmapScaleOffset = { length: 4 }; },
    map: (j) => { j.nodes[1].extras.lightmapIndex = 0.5; },
    material: (j) => { j.meshes[0].primitives[1].material = 99; },
    variant: (j) => { j.meshes[0].primitives[0].extensions.KHR_materials_variants.mappings[0].material = -1; },
    mesh: (j) => { j.nodes[7].mesh = 12; },
    extension: (j) => { j.materials[0].extensions = 'none'; },
    textures: (j) => { j.textures = {}; },
    used: (j) => { j.extensionsUsed = 7; },
    loop: (j) => { j.nodes[4].children = [4]; }
};

// Makes folders like those of sbl_bake, each with one mistake, and bad scenes. from: a good folder; mixed: a good scene
function bakes(folder, from, mixed) {
    const text = fs.readFileSync(path.join(from, 'scene.gltf'), 'latin1');
    const changes = { none: (t) => t.replace(/MOZ_/g, 'MIZ_'),
                      zero: (t) => t.replace(/"intensity": [^}]+/g, '"intensity": 0'),
                      minus: (t) => t.replace(/("intensity": )/g, '$1-'), text: () => '{}', picture: (t) => t,
                      index: (t) => t.replace(/"TEXCOORD_1": \d+/, '"TEXCOORD_1": 99999') };
    for (const [name, change] of Object.entries(changes)) {
        fs.cpSync(from, path.join(folder, name), { recursive: true });
        fs.writeFileSync(path.join(folder, name, 'scene.gltf'), change(text), 'latin1');
    }
    fs.writeFileSync(path.join(folder, 'picture/atlas.png'), 'GIF89a');
    fs.cpSync(mixed.replace('.gltf', '.bin'), path.join(folder, 'mixed.bin'));
    for (const [name, change] of Object.entries(MIXED)) {
        const json = JSON.parse(fs.readFileSync(mixed));
        delete json.nodes[3].extras.lightmapIndex;
        change(json);
        fs.writeFileSync(path.join(folder, `${name}.gltf`), JSON.stringify(json));
    }
}

// Reads lines "LIGHT SCENE WORDS" from the standard input; LIGHT is a folder of sbl_bake, or - without --light. Checks
// that sbl_unwrap refuses each scene with one line that contains WORDS, a regular expression, and that it keeps an
// older file. All scenes are given to the worker of sbl_unwrap in this process, because the start of a process takes
// longer.
async function refuses(folder) {
    const { Worker } = require('worker_threads'), script = path.join(__dirname, '../../scripts/sbl_unwrap');
    const out = path.join(folder, 'kept.glb'), lines = fs.readFileSync(0, 'utf8').split('\n').filter(Boolean);
    let wrong = 0;
    for (const line of lines) {
        const [light, scene, ...rest] = line.split(' '), files = [scene, out], options = { files, gap: 2, time: 60 };
        if (light !== '-') options.light = light;
        fs.writeFileSync(out, 'old');
        const said = await new Promise((resolve) => {
            const thread = new Worker(script, { workerData: { options, folder } });
            let ended = {};
            thread.on('message', (message) => {
                if (message.end !== undefined) ended = message;
            });
            thread.on('error', (error) => resolve({ text: String(error) }));
            thread.on('exit', () => resolve(ended));
        });
        const start = `sbl_unwrap: ${scene}: `, text = said.text || '';
        const fits = text.startsWith(start) && new RegExp(rest.join(' ')).test(text.slice(start.length));
        const plain = /^[ -~]*\n$/.test(text), kept = fs.readFileSync(out, 'utf8') === 'old';
        const left = fs.readdirSync(folder).some((name) => name.includes('part'));
        if (said.end === 1 && fits && plain && kept && !left) continue;
        console.log(`${line}: ${said.end} ${text}`);
        wrong++;
    }
    assert(lines.length > 5 && !wrong, `${wrong} of ${lines.length} scenes`);
}

const [what, ...words] = process.argv.slice(2),
    numbers = words.map((w) => (w === '' || isNaN(w) ? w : Number(w)));
if (what === 'make') {
    const folder = words[0];
    rich(folder);
    odd(folder);
    mixed(folder);
    band(folder, 'strip.gltf', [[0, 0], [0.0025, 0]]);
    band(folder, 'moulding.gltf', [[0, 0], [0.05, 0], [0.055, 0.005], [0.07, 0.005]]);
    band(folder, 'flat.gltf', [[0, 0], [0.05, 0], [0.055, 0], [0.07, 0]]);
    const turn = (k) => (k / 90) * Math.PI;
    const round = Array.from({ length: 13 }, (_, k) => [0.4775 * Math.sin(turn(k)), 0.4775 * Math.cos(turn(k))]);
    band(folder, 'round.gltf', round);
    square(folder, 'usable.gltf', [0, 0, 1, 0, 1, 1, 0, 1]);
    square(folder, 'overlaps.gltf', [0, 0, 1, 0, 1, 1, 1, 0]);
    square(folder, 'coarse.gltf', [0, 0, 1, 0, 1, 1, 0.99, 1]);
    square(folder, 'beyond.gltf', [0, 0, 2, 0, 2, 1, 0, 1]);
    fs.mkdirSync(path.join(folder, 'broken'));
    broken(path.join(folder, 'broken'));
} else if (what === 'bakes') bakes(...words);
else if (what === 'refuses')
    refuses(...words).catch((error) => {
        console.log(error.message);
        process.exit(1);
    });
else checks[what](...numbers);
