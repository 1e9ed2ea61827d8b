/* Part of tool_scene.h: rewrites messages of sbl.h, which name fields and functions of its C interface, for users of
   tools, who know options and files. */
#ifndef TOOL_WORDS_H
#define TOOL_WORDS_H

#include <ctype.h>
#include <stdio.h>
#include <string.h>

/* What messages of sbl.h say, and what a tool says instead. A text precedes those that it contains. */
static const char *const tool__words[][2] = {
    { "check world_to_view, view_to_clip and the scene's bounds", "check --eye, --look-at, --up and --fov" },
    { "; sbl_look_at makes one", "; check --eye, --look-at and --up" },
    { "; sbl_perspective makes one", "; check --fov and --size" },
    { "world_to_view", "the position or direction of the camera" },
    { "view_to_clip", "the projection of the camera" },
    { "check lightmap_texcoords", "check the second texture coordinates of the file (TEXCOORD_1)" },
    { "lightmap_texcoords", "second texture coordinates" },
    { "give it a sky, an environment, lights or a material with emission",
      "give it a sky (--sky), lights or a material with emission" },
    { ", or a smaller texture for sensors (see sbl_context_desc)", "" },
    { ", or set get_gl_function in sbl_context_desc (glXGetProcAddress), so that sbl.h works in it", "" },
    { ", or set get_gl_function in sbl_context_desc", "" },
    { "options.backend is SBL_BACKEND_TRACE", "--backend is trace" },
    { "use SBL_BACKEND_AUTO or SBL_BACKEND_RASTER", "use --backend auto or --backend raster" },
    { "in SBL_MODE_PAPER", "in mode paper" },
    { "options.mode", "--mode" },
    { "options.preset", "--preset" },
    { "options.backend", "--backend" },
    { "options.rays", "--rays" },
    { "options.sensor_size", "--sensor-size" },
    { "smaller sensor_size", "smaller --sensor-size" },
    { "options.epsilon", "--epsilon" },
    { "max_bounce_cells", "--max-bounce-cells" },
    { "target_error", "--target-error" },
    { "filter_radius", "--filter-radius" },
    { "facet_limit", "--facet-limit" },
    { "inner_cone", "the inner cone" }
};

/* Returns 1 if the text at `at` in a message is `words`, and is not a part of a longer name. */
static inline int tool__says(const char *message, const char *at, const char *words) {
    const size_t length = strlen(words);
    const char before = at > message ? at[-1] : ' ', after = strncmp(at, words, length) == 0 ? at[length] : '_';
    return after != '_' && !isalnum((unsigned char)after) &&
           (!isalnum((unsigned char)*words) || (before != '_' && before != '.' && !isalnum((unsigned char)before)));
}

/* Rewrites a message, and drops the name of a descriptor or function at its beginning. */
static inline void tool_translate(char *out, size_t size, const char *message) {
    const size_t count = sizeof tool__words / sizeof *tool__words;
    const char *at = message;
    size_t used = 0, i;
    if (strncmp(at, "sbl_", 4) == 0) {
        const char *end = at + strspn(at, "abcdefghijklmnopqrstuvwxyz_");
        if (strncmp(end, ": ", 2) == 0) at = end + 2;
    }
    out[0] = 0;
    while (*at && used + 1 < size) {
        for (i = 0; i < count && !tool__says(message, at, tool__words[i][0]); i++) continue;
        if (i < count) {
            snprintf(out + used, size - used, "%s", tool__words[i][1]);
            used += strlen(out + used);
            at += strlen(tool__words[i][0]);
        } else {
            out[used++] = *at++;
            out[used] = 0;
        }
    }
}

#endif
