/* A scene file with second texture coordinates: a floor below a lamp, each with a chart of its own. Include after
   tool.h. */
#ifndef MAPPED_ROOM_H
#define MAPPED_ROOM_H

enum { FLOOR, LAMP, QUADS };

/* The corners as in the file. The node of the floor translates them by `moved`. */
static const float quads[QUADS][4][3] = {
    { { -2, 0, -2 }, { -2, 0, 2 }, { 2, 0, 2 }, { 2, 0, -2 } },
    { { -0.5f, 2, -0.5f }, { 0.5f, 2, -0.5f }, { 0.5f, 2, 0.5f }, { -0.5f, 2, 0.5f } }
};
static const float moved[3] = { 0.25f, -0.5f, 0 };
static double strength = 5;

/* Writes the scene. charts: left, upper, right and lower edge of each chart in the map. The v coordinate of the floor
   runs along x. second: 1 to write TEXCOORD_1 */
static void write_scene(const char *name, float charts[QUADS][4], int second) {
    char json[8192], bin[64];
    FILE *out;
    int i, k, n = 0;
    const unsigned indices[6] = { 0, 1, 2, 0, 2, 3 };
    snprintf(bin, sizeof bin, "%s.bin", name);
    out = fopen(in_folder(bin), "wb");
    for (i = 0; i < QUADS; i++) {
        const float *c = charts[i], uv0[8] = { 0, 0, 0, 1, 1, 1, 1, 0 },
            uv1[8] = { c[0], c[1], c[0], c[3], c[2], c[3], c[2], c[1] };
        fwrite(quads[i], 1, 48, out);
        fwrite(uv0, 1, 32, out);
        fwrite(uv1, 1, 32, out);
    }
    fwrite(indices, 1, 24, out);
    fclose(out);
    n += sprintf(json + n, "{\"asset\":{\"version\":\"2.0\"},\"extensionsUsed\":[\"KHR_materials_emissive_strength\"],"
                 "\"scene\":0,\"scenes\":[{\"nodes\":"
                 "[0,1]}],\"nodes\":[{\"name\":\"floor \\\"1\\\"\",\"mesh\":0,\"translation\":[%g,%g,%g]},{\"mesh\":1}]"
                     ",\"meshes\":[",
                 (double)moved[0], (double)moved[1], (double)moved[2]);
    for (i = 0; i < QUADS; i++)
        n += sprintf(json + n, "%s{\"primitives\":[{\"attributes\":{\"POSITION\":%d,\"TEXCOORD_0\":%d%s},\"indices\":6,"
                     "\"material\":%d}]}", i ? "," : "",
                     3 * i, 3 * i + 1, !second ? "" : i ? ",\"TEXCOORD_1\":5" : ",\"TEXCOORD_1\":2", i);
    n += sprintf(json + n, "],\"images\":[{\"uri\":\"floor.ppm\"}],\"textures\":[{\"source\":0}],"
                 "\"materials\":[{\"pbrMetallicRoughness\":{\"baseColorFactor\":"
                 "[0.5,0.5,1,1],\"baseColorTexture\":{\"index\":0},\"metallicFactor\":0}},"
                 "{\"pbrMetallicRoughness\":{\"baseColorFactor\":[0,0,0,1],\"metallicFactor\":0},"
                 "\"emissiveFactor\":[1,1,0.5],"
                 "\"extensions\":{\"KHR_materials_emissive_strength\":{\"emissiveStrength\":%g}}}],\"accessors\":[",
                     strength);
    for (i = 0; i < QUADS; i++)
        n += sprintf(json + n, "{\"bufferView\":%d,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\",\"min\":[%g,%g,"
                     "%g],\"max\":[%g,%g,%g]},"
                     "{\"bufferView\":%d,\"componentType\":5126,\"count\":4,\"type\":\"VEC2\"},{\"bufferView\":%d,"
                         "\"componentType\":5126,\"count\":4,"
                     "\"type\":\"VEC2\"},", 3 * i, (double)quads[i][0][0], (double)quads[i][0][1],
                         (double)quads[i][0][2], (double)quads[i][2][0],
                     (double)quads[i][2][1], (double)quads[i][2][2], 3 * i + 1, 3 * i + 2);
    n += sprintf(json + n, "{\"bufferView\":6,\"componentType\":5125,\"count\":6,\"type\":\"SCALAR\"}],"
                 "\"bufferViews\":[");
    for (i = 0; i < QUADS; i++)
        for (k = 0; k < 3; k++)
            n += sprintf(json + n, "{\"buffer\":0,\"byteOffset\":%d,\"byteLength\":%d},",
                         112 * i + (k ? 16 + 32 * k : 0), k ? 32 : 48);
    n += sprintf(json + n, "{\"buffer\":0,\"byteOffset\":224,\"byteLength\":24}],\"buffers\":[{\"uri\":\"%s\","
                 "\"byteLength\":248}]}", bin);
    write_file(name, json, (size_t)n);
    write_file("floor.ppm", "P6\n2 1\n255\n\xff\xff\xff\x80\x40\xff", 11 + 6);
}

#endif
