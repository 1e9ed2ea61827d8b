/* Demonstrates a baking tool on top of sbl.h: it reads a scene file, bakes its light, and writes the light for engines
   and viewers. `sbl_bake --help` explains its options. */
#define _DEFAULT_SOURCE
#define SBL_IMPLEMENTATION
#define SBL_EGL
#include "../sbl.h"
#include "output_file.h"
#include "picture_file.h"
#include "part_list.h"
#include "picture_parts.h"
#include "bake_parts.h"
#include "scene_file.h"
#include "gltf_file.h"
#include "light_groups.h"
#include "cube_filter.h"
#include "ktx2_file.h"
#include "map_file.h"
#include "lit_file.h"
#define TOOL_NAME "sbl_bake"
#define TOOL_MAKES "bake"
#include "tool.h"
#include "tool_options.h"
#include "tool_scene.h"
#include "tool_part.h"
#include "tool_plan.h"
#include "tool_windows.h"

/* ---- the command line ---- */

static struct options {
    int lightmap, map, gutter, supersample, samples, grid[3], cubemap_size;
    part_choice part;
    const char *join;
    const char *positions;  /* file with the positions of the probes; NULL: they form a grid */
    const char *light_groups;
    double target_error, move, smoothing, ao, facet_limit;
    const char *format_list;
    map_formats formats;
    int lit;
    double stops;  /* exposure of scene_lit.glb; NAN: automatic */
} options = { .stops = NAN };

enum {
    OUTPUT = COMMON_OPTIONS,
    LIGHTMAP,
    MAP,
    GUTTER,
    FORMATS,
    LIT,
    LIT_EXPOSURE,
    DIRECTIONAL,
    AO,
    SHADOW_MASK,
    SUPERSAMPLE,
    FACET_LIMIT,
    LIGHT_GROUPS,
    TARGET_ERROR,
    VERTICES,
    AVERAGE,
    SAMPLES,
    SMOOTHING,
    PROBES,
    MOVE,
    CUBEMAPS,
    CUBEMAP,
    PART,
    PLAN,
    JOIN,
    RESUME,
    OPTION_COUNT
};

#ifdef SBL_RENDER_OPENEXR
  #define MAP_DEFAULT "exr"
#else
  #define MAP_DEFAULT "pfm"
#endif

static const tool_option table[OPTION_COUNT] = {
    COMMON_ROWS,
    [OUTPUT] = { "--output", "FILE", TEXT, &common.output, 0, 0, 0,
                 "also -o; with --lightmap or --cubemaps, FILE is a folder, which is created if it does not exist" },
    [LIGHTMAP] = { "--lightmap", "N|auto", INTEGERS, &options.lightmap, 1, 1, 16384,
                   "bakes all meshes that have a second set of texture coordinates (TEXCOORD_1; sbl_unwrap adds it) "
                   "into one map of N x N texels, and writes these files into the folder of --output:\n"
                   "lightmap.exr    R (irradiance / pi) of each texel, linear; 0 where there is no surface; see "
                   "--formats\n"
                   "atlas.exr       the same, continued into the gutters, for bilinear sampling and mip maps: for "
                   "engines\n"
                   "atlas.png       atlas in 8-bit sRGB; scene.gltf contains its scale\n"
                   "scene.gltf      the scene, with scene.bin and texture_*.png. The extension MOZ_lightmap of each "
                   "material refers to atlas.png: irradiance = intensity * texture, R = irradiance / pi\n"
                   "scene_lit.glb   the scene with its light, for any viewer of glTF, see --lit\n"
                   "overlap.png     written if charts overlap; shared texels are red\n"
                   "maps.json       written if there are several maps: files and factors of each map; for each node "
                   "its map, and scale and offset of TEXCOORD_1\n"
                   "If sbl_unwrap has made several maps for the scene, all are baked with the same bounced light. "
                   "Names of pictures then end in the number of the map: atlas_0.exr, sh_2_0.exr, ... The scene files "
                   "refer to all maps.\n"
                   "--lightmap auto: the size for which sbl_unwrap has made the coordinates", exposure_words },
    [MAP] = { "--map", "K", INTEGERS, &options.map, 1, 0, 9999,
              "with --lightmap: bakes only map K, if sbl_unwrap has made several maps for the scene; the first is 0. "
              "File names then have no number. If there are several maps, --part and --join need --map. Use the same "
              "--store for all maps" },
    [GUTTER] = { "--gutter", "TEXELS", INTEGERS, &options.gutter, 1, 0, 16384,
                 "width of the gutters: atlas continues the light this far beyond the charts; default 16" },
    [FORMATS] = { "--formats", "LIST", TEXT, &options.format_list, 0, 0, 0,
                  "with --lightmap: formats of lightmap, atlas and sh_*, such as exr,ktx2; default " MAP_DEFAULT ":\n"
                  "exr     16-bit floats, at most 65504\n"
                  "exr32   32-bit floats, with the same file names as exr\n"
                  "hdr     RGBE (.hdr); sh_* is not written, because .hdr has no negative values\n"
                  "rgbm    8 bits (.rgbm.png): R = (range * alpha * rgb)^2 with linear bytes; the range is printed, "
                  "and is in the text sbl.range of the file and in the extras of scene.gltf; sh_* is not written\n"
                  "ktx2    16-bit floats for GPUs (.ktx2, RGBA, not compressed)\n"
                  "pfm     32-bit floats (.pfm)\n"
                  "Values beyond the range of a format become its largest value, with a warning" },
    [LIT] = { "--lit", "N", INTEGERS, &options.lit, 1, 0, 16384,
              "with --lightmap: the texture of scene_lit.glb has N x N texels; 0: it is not written. Its materials "
              "are unlit (KHR_materials_unlit), and show colour times light, exposed and tone-mapped (PBR Neutral), "
              "in the charts of the map; it has no reflections or normal maps. Default: 4 times the size of the map, "
              "from 512 to 4096, which keeps textures sharp; without textures, the size of the map, up to 4096. It is "
              "halved until it fits into a quarter of --memory" },
    [LIT_EXPOSURE] = { "--exposure", "STOPS|auto", NUMBERS, &options.stops, 1, -50, 50,
                       "exposure of scene_lit.glb in stops; auto (default): chosen for the light on the surfaces",
                       exposure_words },
    [DIRECTIONAL] = { "--directional", NULL, FLAG, NULL, 0, 0, 0,
                      "with --lightmap: also writes the light by direction, for normal maps: sh_0 to sh_3 are the "
                      "coefficients of the radiance over the hemisphere of each texel, in the real orthonormal "
                      "spherical harmonics 1, y, z, x, continued into the gutters" },
    [AO] = { "--ao", "DISTANCE", NUMBERS, &options.ao, 1, 1e-18, 1e18,
             "with --lightmap: also writes ao.exr and ao.png, the ambient occlusion: the cosine-weighted fraction of "
             "directions in which no surface is within DISTANCE; and sky.exr and sky.png, the fraction of directions "
             "that see the sky. They are continued into the gutters; .png holds linear bytes. --target-error is then "
             "absolute: 0.5% is an error of 0.005 of these fractions. This takes a seventh to two thirds of the time "
             "of a map in mode gi. The map must be baked in one piece: without --part and --join, and not in "
             "windows" },
    [SHADOW_MASK] = { "--shadow-mask", NULL, FLAG, NULL, 0, 0, 0,
                      "with --lightmap: also writes shadow.png (linear bytes) and shadow.exr (16-bit floats): their "
                      "channels R, G, B, A are the visibility of the first four lights of the file, whose names are "
                      "printed; 1 where there is no such light. Visibility is the direct light of one light, divided "
                      "by the same light without shadows; it is 0 behind the surface and outside the cone; "
                      "transparent surfaces (thin panes) reduce it by the fraction that they absorb or reflect. It is "
                      "continued into the gutters. Lights of files have no size, so that edges are hard; "
                      "--supersample smooths them. The map must be baked in one piece: without --part and --join, and "
                      "not in windows" },
    [SUPERSAMPLE] = { "--supersample", "N", INTEGERS, &options.supersample, 1, 1, 8,
                      "with --lightmap: averages measurements at N x N positions in each texel, for shadows finer than "
                      "texels; default 1" },
    [FACET_LIMIT] = { "--facet-limit", "TEXELS", NUMBERS, &options.facet_limit, 1, 0, 1e30,
                      "with --lightmap: triangles of at most this height in the map use geometric normals; those of "
                      "at least twice this height use the normals of the file; triangles in between use a mixture. "
                      "0: all use the normals of the file. Default: 2, but only near sharp edges" },
    [LIGHT_GROUPS] = { "--light-groups", "NAME=PATTERN,...", TEXT, &options.light_groups, 0, 0, 0,
                       "also writes the light of each group of sources, from the same rays. All groups add up to the "
                       "light without groups:\n"
                       "--lightmap   atlas_NAME, in the formats of atlas; not with --directional\n"
                       "--vertices   radiance_NAME_r, _g and _b in a .ply, attribute _RADIANCE_NAME in a .gltf\n"
                       "--probes     sh and cube in the object groups of each probe, under NAME\n"
                       "A source is a light or an emitting mesh, both with the name of their node, or the sky, named "
                       "sky. It belongs to the first group whose pattern matches its name (with * ? and [], as in a "
                       "shell). NAME without =PATTERN means NAME=NAME. A source without a matching pattern belongs to "
                       "the group rest. At most 8 groups" },
    [TARGET_ERROR] = { "--target-error", "E", FRACTIONS, &options.target_error, 1, 0.0001, 1,
                       "with --lightmap: target error of R, such as 2% or 0.02: the root mean square error of the "
                       "map, divided by the mean of R. Default 2%, 0.5%, 0.25% by preset; with the default, a sensor "
                       "uses at most 1024, 2048, 4096 rays. With --cubemaps: that of each face; default as for a "
                       "picture of sbl_render",
                       .synonym = "--error" },
    [VERTICES] = { "--vertices", NULL, FLAG, NULL, 0, 0, 0,
                   "bakes R at the vertices of all meshes, fitted by least squares to the light on their triangles, "
                   "and writes FILE.ply (binary: x y z nx ny nz in world space; radiance_r radiance_g radiance_b, "
                   "which are R; and faces) or FILE.gltf (with a .bin and texture_*.png in the same folder; R is "
                   "vertex attribute _RADIANCE)" },
    [AVERAGE] = { "--average", NULL, FLAG, NULL, 0, 0, 0,
                  "with --vertices: averages the light around each vertex instead of fitting; this is smoother, but "
                  "wrong where triangles are large" },
    [SAMPLES] = { "--samples", "N", INTEGERS, &options.samples, 1, 1, 1024,
                  "with --vertices: number of points on a triangle of mean area; default 4, 8, 16 by preset" },
    [SMOOTHING] = { "--smoothing", "S", NUMBERS, &options.smoothing, 1, 0, 1e6,
                    "with --vertices: how strongly equal slopes of light on both sides of an edge are preferred; 0: "
                    "not at all; default 0.02" },
    [PROBES] = { "--probes", "AxBxC|LIST", SIZES, options.grid, 3, 1, 4096,
                 "bakes light at points in the air, and writes FILE.json. The points are the centres of the cells of "
                 "a grid over the bounds of the scene, x fastest, or the points in a text file LIST.txt, with three "
                 "numbers on each line. Each probe has:\n"
                 "position           of the probe in the world\n"
                 "valid              false inside geometry\n"
                 "sh                 radiance in nine real orthonormal spherical harmonics, rgb each, in the order 1, "
                 "y, z, x, xy, yz, 3z2-1, xz, x2-y2\n"
                 "cube               R on surfaces that face +x -x +y -y +z -z\n"
                 "sky                the fraction of directions that see the sky\n"
                 "distance           mean distance of surfaces for each octant\n"
                 "distance_squared   mean of its square\n"
                 "back_share         the fraction of visible surfaces that are back faces (see sbl_probe in sbl.h)\n"
                 "FILE.json also contains the origin and the spacing of the grid, and the constants and weights that "
                 "convert sh to irradiance; examples/engines/probes.glsl does this in a shader",
                 NULL, &options.positions, .file_words = "a text file such as LIST.txt" },
    [MOVE] = { "--move", "DISTANCE", NUMBERS, &options.move, 1, 0, 1e18,
               "maximum distance by which a probe or a cube map may be moved to get out of geometry; default 0" },
    [CUBEMAPS] = { "--cubemaps", "AxBxC|LIST", SIZES, options.grid, 3, 1, 4096,
                   "bakes the radiance from all directions at points in the air, for reflections. The points are "
                   "given as for --probes. Writes these files into the folder of --output, with NNNN from 0000 on, at "
                   "most 9999:\n"
                   "cubemap_NNNN.ktx2    all levels, half floats; faces +x -x +y -y +z -z as in OpenGL, so that "
                   "sampling in a direction of the world gives the radiance from there\n"
                   "cubemap_NNNN_K.exr   level K as a column of six faces, from the top, in 32-bit floats\n"
                   "cubemaps.json        size and roughness of each level; for each point: position, valid (false "
                   "inside geometry: no files), and a box for parallax correction. Each side of the box lies on the "
                   "parallel surface that fills most of the view; without such a surface, on the bounds of the "
                   "scene\n"
                   "Level K of M has the roughness K / (M - 1); the last one has faces of 4 x 4. Levels are filtered "
                   "by GGX lobes with alpha = roughness^2 and normal = view = reflection, for the split sum (Karis "
                   "2013)",
                   NULL, &options.positions, .file_words = "a text file such as LIST.txt" },
    [CUBEMAP] = { "--cubemap-size", "N", INTEGERS, &options.cubemap_size, 1, 8, CUBE_SIZE_MAX,
                  "with --cubemaps: texels across a face of level 0, a power of two from 8 to 1024; default 128" },
    [PART] = { "--part", "K/N", TEXT, &options.part.text, 0, 0, 0,
               "bakes only the K-th of N parts; N is at most 10000. A part is a range of probes, a range of meshes "
               "(in a .ply), or a window of the lightmap (in an .exr). sbl_merge joins probes and light at vertices: "
               "the joined file is byte-identical to a bake without --part. --join joins a lightmap. In mode gi, give "
               "all parts the same --store, and finish one part before you start the others: it computes the bounced "
               "light, which they load.\n"
               PLAN_AUTO_WORDS },
    [PLAN] = { "--plan", "FILE", TEXT, &options.part.plan, 0, 0, 0,
               "with --lightmap and --part: FILE holds the windows of all parts, and the mean, the price (the least "
               "benefit that a measurement must have) and the number of cells of the complete map, see ON PARTS in "
               "sbl.h. If FILE exists, it is loaded; otherwise a small lightmap is baked, and FILE is made. Parts that "
               "are made with different graphics drivers must share one FILE" },
    [JOIN] = { "--join", "FOLDER", TEXT, &options.join, 0, 0, 0,
               "with --lightmap: bakes nothing, but joins the parts in FOLDER (all its .exr files), fills the gutters "
               "and joins the seams. Repeat the options with which the parts were baked, except --part, --plan and "
               "--store. --memory must allow about 42 bytes for each texel, 90 with --directional, 12 more with each "
               "light group" },
    [RESUME] = { "--resume", NULL, FLAG, NULL, 0, 0, 0,
                 "with --lightmap: continues an interrupted map that is baked window by window. A map is baked window "
                 "by window if it has more than 4096 x 4096 texels or needs more than --memory. Finished windows are "
                 "in the folder OUTPUT.parts (of several maps: OUTPUT_0.parts, ...), which is removed at the end; "
                 "while it exists, a run without --resume is refused" },
};
static int given[OPTION_COUNT];
static light_groups groups;
static sbl_material *grouped_materials;  /* NULL, or the copied materials of groups_assign */

static const tool_line lines[] = {
    { TOOL_HEADING, "Task:" },
    { LIGHTMAP, "a map of N x N texels, into a folder" },
    { MAP, NULL },
    { DIRECTIONAL, "also writes the light by direction, for normal maps" },
    { AO, "also writes ambient occlusion and sky visibility" },
    { SHADOW_MASK, NULL },
    { VERTICES, "light at the vertices, into a .ply or .gltf file" },
    { AVERAGE, NULL },
    { PROBES, "light at the points of a grid or text file, as .json" },
    { MOVE, NULL },
    { CUBEMAPS, "cube maps at points, for reflections; into a folder" },
    { CUBEMAP, NULL },
    { LIGHT_GROUPS, NULL },
    { PART, "bakes only the K-th of N parts; not with --cubemaps" },
    { PLAN, NULL },
    { JOIN, "joins the parts of a lightmap that are in FOLDER" },
    { MODE, "gi (default, with bounces), direct or ambient" },
    { TOOL_HEADING, "Light:" },
    LIGHT_LINES,
    { TOOL_HEADING, "Quality:" },
    { TARGET_ERROR, "accepted error of maps and cube maps, such as 2%" },
    { SUPERSAMPLE, NULL },
    { FACET_LIMIT, NULL },
    { SAMPLES, NULL },
    { SMOOTHING, NULL },
    QUALITY_LINES,
    { TOOL_HEADING, "Output:" },
    { OUTPUT, "also -o; a folder for --lightmap and --cubemaps" },
    { FORMATS, "file formats of a map: exr,exr32,hdr,rgbm,ktx2,pfm" },
    { GUTTER, NULL },
    { LIT, NULL },
    { LIT_EXPOSURE, NULL },
    OUTPUT_LINES,
    { RESUME, NULL },
    { TOOL_HEADING, "Safety:" },
    SAFETY_LINES
};

static void print_help(void) {
    printf(
        "usage: sbl_bake SCENE --lightmap N -o FOLDER [options]\n"
        "       sbl_bake SCENE --vertices -o FILE.ply|FILE.gltf [options]\n"
        "       sbl_bake SCENE --probes AxBxC|LIST -o FILE.json [options]\n"
        "       sbl_bake SCENE --cubemaps AxBxC|LIST -o FOLDER [options]\n\n"
        "Bakes the light of a scene file: .obj .gltf .glb, and others that assimp reads.\n"
        "A lightmap needs a second set of texture coordinates; sbl_unwrap adds it.\n");
    tool_print_help(table, OPTION_COUNT, lines, (int)(sizeof lines / sizeof *lines), common.help_all);
    if (!common.help_all) return;
    tool_print_text("\n"
                    "Materials and lights are read as by sbl_render. If a mesh is used several times, each use needs "
                    "its own area of the lightmap, or the uses overlap. glTF gives the area as lightmapScaleOffset in "
                    "the extras of the node; sbl_unwrap writes it.\n"
                    "\n"
                    "Each file is written completely or not at all.\n"
                    "\n"
                    "If you press Ctrl-C, the unfinished lightmap is saved as lightmap.partial.pfm in the folder, and "
                    "the program ends. If there is no light yet, or with --vertices or --probes, nothing is saved. "
                    "Complete cube maps stay. " TOOL_SIGNALS_WORDS "\n"
                    TOOL_STATUS_WORDS);
}

static int ends_with(const char *path, const char *ending) { return scene__ends_with(path, ending); }

/* Reads the value of --part and checks the output name against it. Returns the exit status. */
static int parse_part(void) {
    int status;
    if (!given[PART]) return DONE;
    if (given[LIGHTMAP] && !ends_with(common.output, ".exr"))
        return misuse("--output %s: a part of a lightmap is an .exr file, and --join joins the parts", common.output);
#ifndef SBL_RENDER_OPENEXR
    if (given[LIGHTMAP])
        return fail("--output %s: parts of a lightmap need OpenEXR, and this program was built without it",
                    common.output);
#endif
    if (given[VERTICES] && !ends_with(common.output, ".ply"))
        return misuse("--output %s: a part is a .ply file, and sbl_merge joins them", common.output);
    status = plan_part_and_output(&options.part);
    if (status == DONE && options.lightmap && (double)options.lightmap * options.lightmap < options.part.count)
        return misuse("--part %s: %d parts are too many for a map of %d x %d texels", options.part.text,
                      options.part.count, options.lightmap, options.lightmap);
    return status;
}

/* Reads and checks the value of --formats. Returns the exit status. */
static int parse_formats(void) {
    const char *list = given[FORMATS] ? options.format_list : MAP_DEFAULT;
    const char *const wrong = map_formats_read(&options.formats, list);
    int i, signs = 0;
    if (wrong) return misuse("--formats %s: %s", list, wrong);
#ifndef SBL_RENDER_OPENEXR
    if (options.formats.wanted[MAP_EXR])
        return fail("--formats %s: exr needs OpenEXR, and this program was built without it", list);
#endif
    for (i = 0; i < MAP_FORMATS; i++) signs |= options.formats.wanted[i] && map_holds_negative((map_format)i);
    if (given[DIRECTIONAL] && !signs)
        return misuse("--directional: hdr and rgbm hold no negative numbers, which sh_* has; add exr, ktx2 or pfm to "
                      "--formats");
    return DONE;
}

/* Returns 1 if this run writes scene_lit.glb. */
static int writes_lit(void) { return !given[LIT] || options.lit > 0; }

static int parse(int argc, char **argv) {
    static const int of_lightmaps[] = {
        MAP, GUTTER, FORMATS, LIT, LIT_EXPOSURE, DIRECTIONAL, AO, SHADOW_MASK, SUPERSAMPLE, FACET_LIMIT, PLAN,
        JOIN, RESUME, TARGET_ERROR, TILE, THRESHOLD, FILTER_RADIUS
    };
    enum { ALSO_OF_CUBEMAPS = 13 };  /* the options from this index on also work with --cubemaps */
    static const int of_vertices[] = { AVERAGE, SAMPLES, SMOOTHING };
    int i;
    const tool_command command = { argc, argv, table, OPTION_COUNT, given, &common.scene, 1 };
    int status = tool_parse(&command);
    if (status != DONE || given[HELP] || given[VERSION]) return status;
    status = common_check(given);
    if (status != DONE) return status;
    if (given[LIGHTMAP] + given[VERTICES] + given[PROBES] + given[CUBEMAPS] != 1)
        return misuse("give one of --lightmap, --vertices, --probes and --cubemaps, to choose what is baked; see "
                      "--help");
    if (!common.output)
        return misuse("--output is missing: %s",
                      given[LIGHTMAP] || given[CUBEMAPS] ? "the folder to write to" : "the file to write");
    for (i = 0; i < (int)(sizeof of_lightmaps / sizeof *of_lightmaps); i++)
        if (given[of_lightmaps[i]] && !given[LIGHTMAP] && !(given[CUBEMAPS] && i >= ALSO_OF_CUBEMAPS))
            return misuse("%s needs --lightmap%s", table[of_lightmaps[i]].name,
                          i < ALSO_OF_CUBEMAPS ? "" : " or --cubemaps");
    for (i = 0; i < (int)(sizeof of_vertices / sizeof *of_vertices); i++)
        if (given[of_vertices[i]] && !given[VERTICES]) return misuse("%s needs --vertices", table[of_vertices[i]].name);
    if (given[RAYS] && (given[PROBES] ? common.rays < 64 : common.rays > 4096))
        return misuse("--rays %d: the number must be %s", common.rays,
                      given[PROBES] ? "64 to 65536, the rays of a probe" : "1 to 4096");
    if (given[MOVE] && !given[PROBES] && !given[CUBEMAPS]) return misuse("--move needs --probes or --cubemaps");
    if (given[CUBEMAP] && !given[CUBEMAPS]) return misuse("--cubemap-size needs --cubemaps");
    if (options.cubemap_size & (options.cubemap_size - 1))
        return misuse("--cubemap-size %d: it must be a power of two, such as 64 or 256", options.cubemap_size);
    if (given[AO] && (given[PART] || given[JOIN]))
        return misuse("--ao needs a map that is baked at once; leave out %s", given[PART] ? "--part" : "--join");
    if (given[AO] && backends[common.backend] == SBL_BACKEND_RASTER)
        return misuse("--ao needs rays, which end at its distance; leave out --backend raster");
    if (given[SHADOW_MASK] && (given[PART] || given[JOIN]))
        return misuse("--shadow-mask needs a map that is baked at once; leave out %s",
                      given[PART] ? "--part" : "--join");
    if (given[SHADOW_MASK] && backends[common.backend] == SBL_BACKEND_RASTER)
        return misuse("--shadow-mask needs rays; leave out --backend raster");
    if (given[CUBEMAPS] && given[PART])
        return misuse("--part does not divide cube maps; give each machine a LIST of its own with --cubemaps");
    if (given[LIGHT_GROUPS] && (given[DIRECTIONAL] || given[CUBEMAPS]))
        return misuse("--light-groups does not work with %s", given[DIRECTIONAL] ? "--directional" : "--cubemaps");
    if (given[LIGHT_GROUPS] && !groups_read(&groups, options.light_groups))
        return misuse("--light-groups %s: %s", options.light_groups, groups.error);
    if (given[PLAN] && !given[PART]) return misuse("--plan needs --part K/N: a plan describes the parts");
    if (given[JOIN] && given[PART]) return misuse("--join joins the parts that --part has made; give only one of them");
    if (given[JOIN] && given[RESUME])
        return misuse("--resume continues a bake, and --join bakes nothing; give only one of them");
    if (given[VERTICES] && !ends_with(common.output, ".ply") && !ends_with(common.output, ".gltf"))
        return misuse("--output %s: the name must end in .ply or .gltf", common.output);
    if (given[PROBES] && !ends_with(common.output, ".json"))
        return misuse("--output %s: the name must end in .json", common.output);
    status = parse_part();
    if (status == DONE) status = parse_formats();
    if (status != DONE) return status;
    common_note(given, table);
    if (given[LIGHTMAP] || given[CUBEMAPS]) common_note_refinement(given, table, TARGET_ERROR);
    note_if(given[AVERAGE], given, table, SMOOTHING, "--average does not use slopes");
    note_if(given[PART], given, table, GUTTER, "--join makes the gutters");
    note_if(given[PART], given, table, FORMATS, "a part is an .exr of 32-bit floats; --join writes the formats");
    note_if(given[PART], given, table, LIT, "--join writes scene_lit.glb");
    note_if(given[PART] || !writes_lit(), given, table, LIT_EXPOSURE, "scene_lit.glb is not written");
    note_if(given[JOIN], given, table, STORE, "--join measures no light");
    if (given[JOIN]) common.store = NULL;
    common.input = given[PLAN] ? options.part.plan : options.positions;
    if (options.positions) memset(options.grid, 0, sizeof options.grid);
    return DONE;
}

/* ---- bakes with a single output file ---- */

enum { ONE_FILE = OWN_TARGETS, VERTEX_BIN, VERTEX_TEXTURES };

/* Adds the file of --output to the targets. Returns the exit status. */
static int find_file(void) {
    targets_begin();
    output_find(&targets[ONE_FILE], common.output);
    target_count = ONE_FILE + 1;
    return targets_check(target_count, given);
}

/* Assigns light groups to the sources of the scene if --light-groups is given. Returns the exit status. */
static int assign_groups(scene_file *file) {
    if (!given[LIGHT_GROUPS] || groups_assign(&groups, file, &grouped_materials)) return DONE;
    return misuse("--light-groups %s: %s", options.light_groups, groups.error);
}

enum { CUBEMAPS_MAX = 10000 };  /* maximum number of cube maps */

#include "sbl_bake_lightmap.h"

/* ---- dividing the work into parts ---- */

static bake_facts facts;  /* identify scene, options and range of this part; without --part, the range is all */

/* Sets the range to `count` of `total` probes or meshes, starting at the index `first`. */
static void set_range(int first, int count, int total) {
    facts.range[BAKE_FIRST] = first;
    facts.range[BAKE_COUNT] = count;
    facts.range[BAKE_TOTAL] = total;
}

/* Returns the number of probes, of `total`, that come before the part with the index k, from 0. */
static int probes_before(int k, int total) { return (int)((long long)k * total / options.part.count); }

/* Sets the range to the probes of this part. Returns the exit status. */
static int find_probes(int total) {
    const int k = options.part.number - 1;
    set_range(0, total, total);
    if (!given[PART]) return DONE;
    if (options.part.count > total)
        return misuse("--part %s: %d parts are too many for %d probes", options.part.text, options.part.count, total);
    set_range(probes_before(k, total), probes_before(k + 1, total) - probes_before(k, total), total);
    return DONE;
}

/* Sets the range to the meshes of this part, so that all parts have about the same number of triangles. A part takes
   the mesh after those of the part before it. It goes on to take the next mesh while, of N parts, part K and those
   before it have no more than K / N of all triangles up to the middle of that mesh, and while one mesh is left for each
   later part. Returns the exit status. */
static int find_meshes(const scene_file *file) {
    const sbl_mesh *m = file->scene.meshes;
    const int meshes = file->scene.mesh_count, parts = options.part.count;
    long long all = 0, before = 0;
    int i, k, first = 0, next = 0;
    set_range(0, meshes, meshes);
    if (!given[PART]) return DONE;
    if (parts > meshes)
        return misuse("--part %s: %d parts are too many for %d meshes: a part contains at least one mesh",
                      options.part.text, parts, meshes);
    for (i = 0; i < meshes; i++) all += m[i].index_count / 3;
    for (k = 1; k <= options.part.number; k++) {
        first = next;
        do before += m[next++].index_count / 3;
        while (next < meshes - (parts - k) && (2 * before + m[next].index_count / 3) * parts <= 2 * k * all);
    }
    set_range(first, next - first, meshes);
    return DONE;
}

/* Sets the texts of the facts. what: describes what is baked, as far as the options do not */
static void find_facts(const sbl_context *context, const char *what) {
    static const int without[] = { OUTPUT, STATS, STORE, STORE_REPLACE, QUIET, VERBOSE, ALLOW_PATH, MEMORY, READ_TIME,
                                   VERTICES, PROBES, PART, -1 };
    char text[16 * PICTURE_FACT_SIZE];
    if (!given[PART]) return;
    bake_fact(&facts, BAKE_VERSION, sbl_version());
    snprintf(text, sizeof text, "%016llx", (unsigned long long)sbl_scene_fingerprint(context));
    bake_fact(&facts, BAKE_SCENE, text);
    bake_fact(&facts, BAKE_WHAT, what);
    plan_options(text, sizeof text, table, OPTION_COUNT, given, without);
    if (!bake_fact(&facts, BAKE_OPTIONS, text)) {
        snprintf(text, sizeof text, "%016llx", plan_hash(PLAN_HASH_START, text, strlen(text)));
        bake_fact(&facts, BAKE_OPTIONS, text);
    }
    bake_fact(&facts, BAKE_RENDERER, sbl_query_capabilities(context).renderer);
    snprintf(text, sizeof text, "%d/%d", options.part.number, options.part.count);
    bake_fact(&facts, BAKE_PART, text);
}

/* ---- baking vertices ---- */

typedef struct vertices {
    const sbl_scene_desc *scene;
    const sbl_mesh *meshes;  /* the meshes that are baked, a range of the meshes of the scene */
    int mesh_count;
    float *radiance;         /* R of all vertices, then the light of each group */
    size_t count;            /* number of vertices of these meshes */
    double faces;
    gltf_file gltf;
    int texture;
} vertices;

static char bin_name[PATH_MAX];

/* Finds the meshes of this part. If --output is a .gltf, also lists the files that it refers to. Returns the exit
   status. */
static int find_vertex_files(scene_file *file) {
    const char *slash = strrchr(common.output, '/'), *base = slash ? slash + 1 : common.output;
    const size_t folder = (size_t)(base - common.output);
    int status = find_meshes(file);
    if (status == DONE) status = assign_groups(file);
    if (status != DONE) return status;
    if (!ends_with(common.output, ".gltf")) return DONE;
    snprintf(bin_name, sizeof bin_name, "%.*s.bin", (int)(strlen(base) - 5), base);
    status = target_add(VERTEX_BIN, folder, bin_name);
    if (status == DONE) status = find_textures(file, VERTEX_TEXTURES, folder);
    return status == DONE ? targets_check(VERTEX_BIN + 1, given) : status;
}

static void transform_point(const float m[16], const float *p, double out[3]) {
    int k, moved = 0;
    for (k = 0; k < 16; k++) moved |= m[k] != 0.0f;
    for (k = 0; k < 3; k++)
        out[k] = !moved ? (double)p[k] : (double)m[k] * (double)p[0] + (double)m[4 + k] * (double)p[1] +
            (double)m[8 + k] * (double)p[2] + (double)m[12 + k];
}

static void add_cross(const double a[3], const double b[3], double scale, double out[3]) {
    out[0] += scale * (a[1] * b[2] - a[2] * b[1]);
    out[1] += scale * (a[2] * b[0] - a[0] * b[2]);
    out[2] += scale * (a[0] * b[1] - a[1] * b[0]);
}

/* Transforms a normal by the cofactor matrix, which keeps it perpendicular to the surface. If the matrix mirrors, the
   sign of the determinant flips the normal. */
static void transform_normal(const float m[16], const float *n, double out[3]) {
    double column[3][3], normal[3] = { 0, 0, 0 }, determinant[3] = { 0, 0, 0 };
    int i, k, moved = 0;
    for (k = 0; k < 16; k++) moved |= m[k] != 0.0f;
    for (i = 0; i < 3; i++) for (k = 0; k < 3; k++) column[i][k] = moved ? (double)m[4 * i + k] : i == k;
    for (i = 0; i < 3; i++) add_cross(column[(i + 1) % 3], column[(i + 2) % 3], (double)n[i], normal);
    add_cross(column[1], column[2], 1, determinant);
    for (k = 0; k < 3; k++)
        out[k] = normal[k] * (determinant[0] * column[0][0] + determinant[1] * column[0][1] + determinant[2] *
                              column[0][2] < 0 ? -1 : 1);
}

/* Returns the unit normals of all vertices in world space: the normals of the file, or else the mean of the normals of
   the adjoining triangles, weighted by area. The caller frees them. Returns NULL if memory runs out. */
static double *normals_of(const sbl_mesh *m) {
    const float *positions = (const float *)m->positions.data, *normals = (const float *)m->normals.data;
    const uint32_t *indices = (const uint32_t *)m->indices.data;
    double *out = (double *)calloc(3 * (size_t)m->vertex_count + 1, sizeof *out), corners[3][3], a[3], b[3];
    int i, k, corner;
    for (i = 0; out && normals && i < m->vertex_count; i++)
        transform_normal(m->transform, normals + 3 * (size_t)i, out + 3 * (size_t)i);
    for (i = 0; out && !normals && i < m->index_count; i += 3) {
        for (corner = 0; corner < 3; corner++)
            transform_point(m->transform, positions + 3 * (size_t)indices[i + corner], corners[corner]);
        for (k = 0; k < 3; k++) { a[k] = corners[1][k] - corners[0][k]; b[k] = corners[2][k] - corners[0][k]; }
        for (corner = 0; corner < 3; corner++) add_cross(a, b, 1, out + 3 * (size_t)indices[i + corner]);
    }
    for (i = 0; out && i < m->vertex_count; i++) {
        double *n = out + 3 * (size_t)i;
        const double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        for (k = 0; k < 3 && length > 0; k++) n[k] /= length;
    }
    return out;
}

static void put_float(FILE *out, double number) {
    const float value = (float)number;
    uint32_t word;
    memcpy(&word, &value, 4);
    gltf__put_word(out, word);
}

static int write_ply(FILE *out, const void *what) {
    const vertices *v = (const vertices *)what;
    const sbl_mesh *m = v->meshes, *const end = v->meshes + v->mesh_count;
    const float *radiance = v->radiance;
    uint32_t first = 0;
    int i, k, layer;
    bake_put_vertices_head(out, given[PART] ? &facts : NULL, &groups.list, (double)v->count, v->faces);
    for (; m < end; m++) {
        double *normals = normals_of(m), at[3];
        if (!normals) return 0;
        for (i = 0; i < m->vertex_count; i++, radiance += 3) {
            transform_point(m->transform, (const float *)m->positions.data + 3 * (size_t)i, at);
            for (k = 0; k < 3; k++) put_float(out, at[k]);
            for (k = 0; k < 3; k++) put_float(out, normals[3 * (size_t)i + (size_t)k]);
            for (layer = 0; layer <= groups.list.count; layer++)
                for (k = 0; k < 3; k++) put_float(out, (double)radiance[3 * v->count * (size_t)layer + (size_t)k]);
        }
        free(normals);
    }
    for (m = v->meshes; m < end; first += (uint32_t)m->vertex_count, m++)
        for (i = 0; i < m->index_count; i++) {
            if (i % 3 == 0) fputc(3, out);
            gltf__put_word(out, first + ((const uint32_t *)m->indices.data)[i]);
        }
    return 1;
}

static int write_vertex_gltf(FILE *out, const void *what) {
    return gltf_write_json(out, &((const vertices *)what)->gltf);
}
static int write_vertex_bin(FILE *out, const void *what) {
    return gltf_write_bin(out, &((const vertices *)what)->gltf);
}
static int write_vertex_texture(FILE *out, const void *what) {
    const vertices *v = (const vertices *)what;
    return gltf_write_texture(out, &v->gltf, v->texture);
}

static int keep_vertices(vertices *v) {
    const int gltf = ends_with(common.output, ".gltf"), files = gltf ? v->scene->texture_count + 2 : 1;
    int i;
    for (i = 0; i < files; i++) {  /* the file that refers to all others is written last */
        const int last = i == files - 1, bin = i == files - 2;
        output_file *target = &targets[last ? ONE_FILE : bin ? VERTEX_BIN : VERTEX_TEXTURES + i];
        v->texture = i;
        if (interrupted || !target_write(target,
                                         last ? gltf ? write_vertex_gltf : write_ply : bin ? write_vertex_bin
                                         : write_vertex_texture, v, 0))
            return interrupted ? stop("%s was not written", target->name) : fail_to_write(target->name);
    }
    return DONE;
}

/* Sets the meshes of the bake. list: receives the indices of the meshes of this part */
static void choose_meshes(vertices *v, sbl_vertices_desc *desc, int *list) {
    int i;
    v->meshes = v->scene->meshes + facts.range[BAKE_FIRST];
    v->mesh_count = facts.range[BAKE_COUNT];
    for (i = 0; i < v->mesh_count; i++) {
        v->count += (size_t)v->meshes[i].vertex_count;
        v->faces += v->meshes[i].index_count / 3;
        list[i] = facts.range[BAKE_FIRST] + i;
    }
    desc->meshes = list;
    desc->mesh_count = v->mesh_count;
}

static int bake_vertices(tool_task *task, double *seconds) {
    progress bar = { !given[QUIET] && isatty(STDERR_FILENO), now(), 0, 0, 0 };
    int *list = (int *)calloc((size_t)facts.range[BAKE_COUNT] + 1, sizeof *list), status, k;
    static const char *names_of_groups[GLTF_PARTS];
    sbl_vertices_desc desc;
    vertices v;
    sbl_result result = SBL_ERROR_OUT_OF_MEMORY;
    if (!list) return fail("out of memory");
    memset(&v, 0, sizeof v);
    memset(&desc, 0, sizeof desc);
    v.scene = &task->file->scene;
    choose_meshes(&v, &desc, list);
    find_facts(task->context, "vertices");
    desc.group_float_count = 3 * v.count * (size_t)groups.list.count;
    v.radiance = (float *)calloc(3 * v.count + desc.group_float_count + 1, sizeof *v.radiance);
    v.gltf.scene = v.scene;
    v.gltf.names = task->file->names;
    v.gltf.bin = bin_name;
    v.gltf.radiance = v.radiance;
    for (k = 0; k < groups.list.count; k++) names_of_groups[k] = groups.list.names[k];
    v.gltf.parts = names_of_groups;
    v.gltf.part_count = groups.list.count;
    v.gltf.vertex_count = v.count;
    desc.radiance = v.radiance;
    if (groups.list.count && v.radiance) desc.groups = v.radiance + 3 * v.count;
    desc.average = given[AVERAGE];
    desc.samples = options.samples;
    if (given[SMOOTHING]) desc.smoothing = zero_or(options.smoothing);
    desc.float_count = 3 * v.count;
    desc.options = common_options(given, &bar);
    if (v.radiance) result = sbl_begin_vertices(task->context, &desc);
    if (result == SBL_SUCCESS) result = work(task->context);
    clear_progress(&bar);
    *seconds = now() - task->start;
    if (result == SBL_UNFINISHED) status = stop("nothing was written");
    else status = result == SBL_SUCCESS ? keep_vertices(&v) : fail_with(task->said, common.scene, result);
    if (status == DONE && bar.shown)
        fprintf(stderr, "%s: %.0f vertices, %.1f s\n", common.output, (double)v.count, *seconds);
    free(v.radiance);
    free(list);
    return status;
}

/* ---- baking probes ---- */

typedef struct probes { sbl_probe *all, *parts; float *positions; int count; bake_grid grid; } probes;

static probes listed;  /* the positions from the file of --probes or --cubemaps */

/* Reads three numbers, separated by blanks or a comma. Returns 1; or 0 if the line is empty or a comment; or -1 if it
   is anything else. line: may begin with a byte order mark */
static int read_position(char *line, float out[3]) {
    char *at, *end;
    int k;
    if (strncmp(line, "\xef\xbb\xbf", 3) == 0) line += 3;
    line[strcspn(line, "#\r\n")] = 0;
    at = line;
    if (!line[strspn(line, " \t")]) return 0;
    for (k = 0; k < 3; k++, at = end + (*end == ',')) {
        const double number = strtod(at, &end);
        if (end == at || !(number >= -1e18 && number <= 1e18)) return -1;
        out[k] = (float)number;
        end += strspn(end, " \t");
    }
    return *at ? -1 : 1;
}

/* Reads the file of positions, if one is given. Returns the exit status. */
static int read_positions(void) {
    probes *p = &listed;
    FILE *in = options.positions ? input_open(options.positions) : NULL;
    char *line = NULL;
    size_t size = 0;
    int room = 0, number = 0, status = DONE;
    if (!options.positions) return DONE;
    if (!in) return fail("%s: cannot be read: %s", options.positions, scene__why());
    while (status == DONE && getline(&line, &size, in) >= 0) {
        float position[3];
        const int kind = read_position(line, position);
        number++;
        if (kind < 0) status = fail("%s: line %d is not three numbers", options.positions, number);
        if (kind <= 0) continue;
        if (p->count == room) {
            float *larger = room > INT_MAX / 8 ? NULL
                : (float *)realloc(p->positions, (size_t)(room = 2 * room + 64) * sizeof position);
            if (!larger) { status = fail("%s: too many positions for the memory", options.positions); break; }
            p->positions = larger;
        }
        memcpy(p->positions + 3 * (size_t)p->count++, position, sizeof position);
    }
    free(line);
    fclose(in);
    if (status == DONE && !p->count) status = fail("%s: it has no positions", options.positions);
    return status;
}

static int write_probes(FILE *out, const void *what) {
    const probes *p = (const probes *)what;
    int i;
    bake_put_probes_head(out, given[PART] ? &facts : NULL, &p->grid, &groups.list);
    for (i = 0; i < p->count; i++) {
        fprintf(out, i ? ",\n" : "\n");
        bake_put_probe(out, &p->all[i], &groups.list, p->parts + (size_t)i * (size_t)groups.list.count);
    }
    fprintf(out, "\n%s", bake_probes_end);
    return 1;
}

/* Reads the positions of the probes, checks their number, and sets the range of this part. Returns the exit status. */
static int prepare_probes(void) {
    const int *grid = options.grid;
    const double points = (double)grid[0] * grid[1] * grid[2];
    const int status = read_positions();
    if (points >= INT_MAX)
        return misuse("%s %dx%dx%d: the grid has %.0f points; at most %d are possible",
                      table[given[CUBEMAPS] ? CUBEMAPS : PROBES].name, grid[0], grid[1], grid[2], points,
                      given[CUBEMAPS] ? CUBEMAPS_MAX : INT_MAX - 1);
    if (status == DONE && given[CUBEMAPS] && (points > CUBEMAPS_MAX || listed.count > CUBEMAPS_MAX))
        return misuse("--cubemaps: %.0f points are too many; at most %d are possible", points + listed.count,
                      CUBEMAPS_MAX);
    return status == DONE ? find_probes(options.positions ? listed.count : (int)points) : status;
}

/* Writes a text that identifies the probes: the size of their grid, or their number and a hash of their positions. */
static void describe_probes(char *out, size_t size) {
    const size_t bytes = 12 * (size_t)listed.count;
    if (options.positions)
        snprintf(out, size, "%d listed probes, hash %016llx", listed.count,
                 plan_hash(PLAN_HASH_START, listed.positions, bytes));
    else snprintf(out, size, "probes of %dx%dx%d", options.grid[0], options.grid[1], options.grid[2]);
}

static int bake_probes(tool_task *task, double *seconds) {
    progress bar = { !given[QUIET] && isatty(STDERR_FILENO), now(), 0, 0, 0 };
    sbl_probes_desc desc;
    const sbl_bounds bounds = sbl_query_bounds(task->context);
    probes p = listed;
    sbl_result result = SBL_SUCCESS;
    int status = DONE, k, valid = 0;
    char what[64];
    describe_probes(what, sizeof what);
    find_facts(task->context, what);
    memset(&desc, 0, sizeof desc);
    memcpy(desc.grid, options.grid, sizeof desc.grid);
    memcpy(p.grid.count, options.grid, sizeof p.grid.count);
    bake_grid_make_layout(&p.grid, bounds.lowest, bounds.highest);
    p.count = facts.range[BAKE_COUNT];
    desc.first_probe = facts.range[BAKE_FIRST];
    p.all = (sbl_probe *)calloc((size_t)p.count * (1 + (size_t)groups.list.count) + 1, sizeof *p.all);
    p.parts = p.all + (p.all ? p.count : 0);
    if (p.positions) desc.positions = p.positions + 3 * (size_t)desc.first_probe;
    desc.probes = p.all;
    if (groups.list.count) desc.groups = p.parts;
    desc.probe_count = p.count;
    desc.move = (float)options.move;
    desc.options = common_options(given, &bar);
    if (!p.all) result = SBL_ERROR_OUT_OF_MEMORY;
    if (result == SBL_SUCCESS && p.count) result = sbl_begin_probes(task->context, &desc);
    if (result == SBL_SUCCESS && p.count) result = work(task->context);
    clear_progress(&bar);
    *seconds = now() - task->start;
    if (result == SBL_UNFINISHED) status = stop("nothing was written");
    else if (result != SBL_SUCCESS) status = fail_with(task->said, common.scene, result);
    else if (!target_write(&targets[ONE_FILE], write_probes, &p, 0))
        status = interrupted ? stop("nothing was written") : fail_to_write(common.output);
    for (k = 0; k < p.count && status == DONE; k++) valid += p.all[k].valid;
    if (status == DONE && bar.shown)
        fprintf(stderr, "%s: %d probes, %d valid, %.1f s\n", common.output, p.count, valid, *seconds);
    free(p.all);
    return status;
}

#include "sbl_bake_cubemaps.h"

/* ---- the main program ---- */

int main(int argc, char **argv) {
    const double start = now();
    int i, status = parse(argc, argv);
    if (status != DONE) return status;
    if (given[HELP]) { print_help(); return fflush(stdout) == 0 ? DONE : FAILED; }
    if (given[VERSION]) { printf("sbl_bake %s\n", sbl_version()); return fflush(stdout) == 0 ? DONE : FAILED; }
    catch_signals();
    status = given[CUBEMAPS] ? find_cubemaps() : given[LIGHTMAP] && !given[PART] ? find_files() : find_file();
    if (status == DONE) status = plan_check(&options.part);
    if (status == DONE && (given[PROBES] || given[CUBEMAPS])) status = prepare_probes();
    if (status == DONE)
        status = given[LIGHTMAP]   ? tool_run(start, given, bake_lightmap, find_more_files, NULL)
               : given[VERTICES]   ? tool_run(start, given, bake_vertices, find_vertex_files, NULL)
               : given[CUBEMAPS]   ? tool_run(start, given, bake_cubemaps, NULL, NULL)
                                   : tool_run(start, given, bake_probes, assign_groups, NULL);
    targets_free();
    free(listed.positions);
    free(grouped_materials);
    if (folder_is_new && status != DONE) rmdir(common.output);  /* does not remove a folder that contains files */
    for (i = 0; i < TARGETS_MAX; i++) free(paths[i]);
    return status;
}
