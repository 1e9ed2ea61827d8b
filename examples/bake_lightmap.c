/* Demonstrates the shortest useful bake. It bakes the Cornell box into one lightmap, bake_lightmap.png, in which each
   quad is a chart. A renderer draws albedo * light + emission with this map. The first argument is the folder for the
   picture. With a second argument, the light is a draft with few cells for bounced light. */
#define SBL_IMPLEMENTATION
#include "headless.h"
#include "cornell_box.h"
#define STB_IMAGE_WRITE_IMPLEMENTATION
#include <stb/stb_image_write.h>

enum { RESOLUTION = 256, CELLS = 4, GAP = 4 };  /* texels per row, charts per row, gap in texels */

/* Computes the lightmap coordinates (0 to 1) of the corners of quad i, which has its own square cell of the map. For a
   scene without lightmap coordinates, use an unwrapper such as xatlas or Blender. */
static void chart(int i, float texcoords[8]) {
    const float gap = (float)GAP / RESOLUTION, cell = 1.0f / CELLS, x = (float)(i % CELLS) * cell,
        y = (float)(i / CELLS) * cell;
    int corner;
    for (corner = 0; corner < 4; corner++) {
        texcoords[2 * corner] = corner == 1 || corner == 2 ? x + cell - gap : x + gap;
        texcoords[2 * corner + 1] = corner >= 2 ? y + cell - gap : y + gap;
    }
}

int main(int argc, char **argv) {
    static float light[RESOLUTION * RESOLUTION * 3], texcoords[CORNELL_QUADS][8];
    static unsigned char pixels[RESOLUTION * RESOLUTION * 3];
    cornell_box box;
    sbl_scene_desc scene = *cornell_box_make(&box);
    const sbl_preset preset = argc > 2 ? SBL_PRESET_DRAFT : SBL_PRESET_DEFAULT;
    const sbl_lightmap_desc map = {  /* other fields: default */
        .width = RESOLUTION, .height = RESOLUTION, .options.preset = preset };
    sbl_context *context;
    sbl_stats stats;
    char path[1024];
    int i, ok;
    for (i = 0; i < CORNELL_QUADS; i++) {
        chart(i, texcoords[i]);
        box.meshes[i].lightmap_texcoords.data = texcoords[i];
    }
    if (argc > 2) scene.max_bounce_cells = 2048;
    /* sbl.h prints error messages to stderr */
    if (sbl_create(headless("bake_lightmap"), &context) != SBL_SUCCESS) return 1;
    ok = sbl_set_scene(context, &scene) == SBL_SUCCESS && sbl_bake_lightmap(context, &map) == SBL_SUCCESS &&
         sbl_read_channel(context, SBL_CHANNEL_FINAL, light, RESOLUTION * RESOLUTION * 3) == SBL_SUCCESS;
    stats = sbl_query_stats(context);
    sbl_destroy(context);
    if (!ok) return 1;
    printf("bake_lightmap: %d texels, %.1f s; the light is off by %.1f %% according to the prediction\n",
           stats.picture.visible_pixels, stats.seconds.total, 100 * (double)stats.picture.expected_error);
    sbl_encode_srgb8(pixels, light, RESOLUTION * RESOLUTION * 3, 1);
    snprintf(path, sizeof path, "%s/bake_lightmap.png", argc > 1 ? argv[1] : ".");
    if (stbi_write_png(path, RESOLUTION, RESOLUTION, 3, pixels, 0)) return 0;
    return fprintf(stderr, "bake_lightmap: cannot write %s\n", path), 1;
}
