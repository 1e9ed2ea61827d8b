// A plug-in of three.js' GLTFLoader that shows scene.gltf of `sbl_bake --lightmap` with its baked light:
//
//     const loader = new GLTFLoader();
//     loader.register((parser) => new MOZLightmap(parser));
//     const { scene } = await loader.loadAsync('baked/scene.gltf');
//
// Materials then have the lightmap of the extension MOZ_lightmap, in the second set of texture coordinates. Lights are
// not needed. `map` replaces the 8-bit map of the file by one without limit of brightness, in the format of three.js'
// KTX2Loader, EXRLoader or HDRLoader; sbl_bake writes R = irradiance / pi, therefore its intensity is pi. Textures of
// glTF have v = 0 at the top, so flipY must be true for an .exr, whose rows EXRLoader reverses, false for a .hdr, and
// stays as it is for a .ktx2:
//
//     const map = await new EXRLoader().loadAsync('baked/atlas.exr');
//     map.flipY = true;
//     loader.register((parser) => new MOZLightmap(parser, map));
//
// sbl_unwrap --light writes the same extension into the scene that was baked. Uses of a mesh that share its coordinates
// have KHR_texture_transform in it, which moves them to their places in the map.
//
// Matte materials become MeshLambertMaterial. Without this, three.js would give them a faint reflection at the cost of
// their diffuse light, and they would be 2 to 3 % darker than in the bake.
import { LinearFilter, MeshLambertMaterial, SRGBColorSpace } from 'three';

export class MOZLightmap {
    constructor(parser, map = null) {
        this.name = 'MOZ_lightmap';
        this.parser = parser;
        this.map = map && Object.assign(map, {
            channel: 1, generateMipmaps: false, minFilter: LinearFilter, magFilter: LinearFilter, needsUpdate: true
        });
        this.moved = new Map();  // copies of `map`, keyed by the JSON of their KHR_texture_transform
    }

    // Returns the extension of a material, or undefined.
    of(index) { return this.parser.json.materials[index].extensions?.[this.name]; }

    isMatte(index) {
        const pbr = this.parser.json.materials[index].pbrMetallicRoughness ?? {};
        return pbr.metallicFactor === 0 && (pbr.roughnessFactor ?? 1) === 1 && !pbr.metallicRoughnessTexture;
    }

    // Returns `map`, or a copy of it that is moved as the extension tells. Copies share the pixels.
    mapOf(light) {
        const move = light.extensions?.KHR_texture_transform, key = JSON.stringify(move);
        if (!move) return this.map;
        if (!this.moved.has(key)) {
            const copy = Object.assign(this.map.clone(), { needsUpdate: true });
            if (move.offset) copy.offset.fromArray(move.offset);
            if (move.scale) copy.repeat.fromArray(move.scale);
            this.moved.set(key, copy);
        }
        return this.moved.get(key);
    }

    getMaterialType(index) { return this.of(index) && this.isMatte(index) ? MeshLambertMaterial : null; }

    async extendMaterialParams(index, params) {
        const light = this.of(index);
        if (!light) return;
        if (this.isMatte(index))  // what a Lambert material does not have
            for (const name of ['metalness', 'roughness', 'metalnessMap', 'roughnessMap']) delete params[name];
        params.lightMapIntensity = this.map ? Math.PI : light.intensity ?? 1;
        if (this.map) params.lightMap = this.mapOf(light);
        else await this.parser.assignTexture(params, 'lightMap', { texCoord: 1, ...light }, SRGBColorSpace);
    }
}
