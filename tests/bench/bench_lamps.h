/* bench lamps: measures the time of a sensor under 1 to 10,000 emitting triangles of the same total area, at equal
   error. The triangles are a panel that is cut into more and more pieces, or are scattered through the room. A plate
   below them hides some, so that nearly every sensor has a penumbra. There is a sensor at every pixel; the truth is
   from 4,096 rays with other seeds. */
#ifndef BENCH_LAMPS_H
#define BENCH_LAMPS_H

enum { LAMP_KINDS = 2, LAMP_COUNTS = 5, LAMP_RAYS = 3, LAMP_RUNS = 3, LAMP_SIDE = 48 };
static const char *const lamp_kinds[LAMP_KINDS] = { "panel", "scattered" };
static const int lamp_rays[LAMP_RAYS] = { 64, 256, 1024 };
static const double lamp_target = 0.01;  /* relative RMSE at which times are compared */

/* Makes at least `count` triangles with x and z from -4 to 4, y about 4, and a total area of 4. Returns their
   number. */
static int lamps_scatter(int kind, int count, float *corners) {
    int side = (int)ceil(sqrt(count / 2.0)), made = 0, i, k;
    uint32_t state = 5;
    double size = sqrt(2 * 4.0 / count);
    for (i = 0; kind == 0 && i < side * side && made < count; i++) {
        float x = (float)(i % side), z = (float)(i / side), d = 2.0f / (float)side;
        float square[18] = { x, 0, z, x + 1, 0, z, x + 1, 0, z + 1, x, 0, z, x + 1, 0, z + 1, x, 0, z + 1 };
        for (k = 0; k < (made + 2 <= count ? 18 : 9); k++) corners[9 * made + k] = k % 3 == 1 ? 4 : square[k] * d - 1;
        made += made + 2 <= count ? 2 : 1;
    }
    for (i = 0; kind == 1 && i < count; i++, made++) {
        double middle[3], turn = 6.283185307 * room_random(&state);
        middle[0] = 8 * room_random(&state) - 4;
        middle[1] = 4 + room_random(&state);
        middle[2] = 8 * room_random(&state) - 4;
        for (k = 0; k < 3; k++) {
            corners[9 * i + 3 * k] = (float)(middle[0] + (k == 1 ? size * cos(turn) : 0));
            corners[9 * i + 3 * k + 1] = (float)(middle[1] + (k == 2 ? 0.5 * size : 0));
            corners[9 * i + 3 * k + 2] = (float)(middle[2] + (k == 1 ? size * sin(turn) : k == 2 ? 0.5 * size : 0));
        }
    }
    return made;
}

/* Returns R at every pixel, which the caller frees. seconds: receives the seconds per sensor */
static float *lamps_render(sbl_context *context, int rays, uint32_t seed, double *seconds) {
    float *radiance = (float *)malloc(LAMP_SIDE * LAMP_SIDE * 3 * sizeof(float));
    sbl_picture_desc view = { 0 };
    sbl_stats stats;
    view.width = view.height = LAMP_SIDE;
    view.options.mode = SBL_MODE_DIRECT;
    view.tile = 1;
    view.filter_radius = -1;
    view.samples = 1;
    view.options.rays = rays;
    view.options.seed = seed;
    sbl_perspective(view.view_to_clip, 40, 1);
    sbl_look_at(view.world_to_view, 0, 3.5f, 0.01f, 0, 0, 0, 0, 1, 0);
    if (!radiance || sbl_render_picture(context, &view) != SBL_SUCCESS ||
        sbl_read_channel(context, SBL_CHANNEL_RADIANCE, radiance, LAMP_SIDE * LAMP_SIDE * 3) != SBL_SUCCESS) {
        free(radiance);
        fail("lamps: a picture failed");
        return NULL;
    }
    stats = sbl_query_stats(context);
    *seconds = stats.seconds.gather / (double)stats.sensors.sites;
    return radiance;
}

static int lamps_scene(sbl_context *context, int kind, int count) {
    static const float plates[24] = { -4, 0, -4, -4, 0, 4, 4, 0, 4, 4, 0, -4, -0.7f, 1, -0.7f, -0.7f, 1, 0.7f, 0.7f, 1,
        0.7f, 0.7f, 1, -0.7f };
    static const unsigned char quad[] = { 0, 1, 2, 0, 2, 3 };
    float *corners = (float *)malloc(9 * sizeof(float) * (size_t)(count + 2));
    sbl_material materials[2];
    sbl_mesh meshes[3];
    sbl_scene_desc scene = { 0 };
    int i, k, ok;
    if (!corners) return fail("lamps: out of memory");
    memset(materials, 0, sizeof materials);
    memset(meshes, 0, sizeof meshes);
    for (i = 0; i < 2; i++)
        for (k = 0; k < 3; k++) { materials[0].albedo[k] = 0.7f; materials[1].emission[k] = 10; }
    for (i = 0; i < 2; i++) {
        meshes[i].positions.data = plates + 12 * i;
        meshes[i].vertex_count = 4;
        meshes[i].indices.data = quad;
        meshes[i].indices.type = SBL_UINT8;
        meshes[i].index_count = 6;
    }
    meshes[2].positions.data = corners;
    meshes[2].vertex_count = 3 * lamps_scatter(kind, count, corners);
    meshes[2].material = 1;
    scene.meshes = meshes;
    scene.mesh_count = 3;
    scene.materials = materials;
    scene.material_count = 2;
    ok = sbl_set_scene(context, &scene) == SBL_SUCCESS;
    free(corners);
    return ok || fail("lamps: the scene is refused");
}

static int lamps_part(int json, int quick) {
    sbl_context_desc desc = { 0 };
    sbl_context *context = NULL;
    int kind, number, rays, run, i, ok;
    desc.get_gl_function = gl_function;
    if (sbl_create(&desc, &context) != SBL_SUCCESS) return fail("lamps: no context");
    if (!json)
        printf("lamps: microseconds per sensor, relative RMSE; time at an error of %g %%, from the line through the "
               "measured points\n\n"
                      "| lamps | triangles | 64 rays | 256 | 1024 | at %g %% |\n|---|---|---|---|---|---|\n",
                          100 * lamp_target, 100 * lamp_target);
    else printf("%s\"lamps\": [", ", ");
    for (kind = 0, ok = 1; kind < LAMP_KINDS && ok; kind++)
        for (number = 0; number < (quick ? 3 : LAMP_COUNTS) && ok; number++) {
            int count = (int)(pow(10, number) + 0.5), runs = quick ? 1 : LAMP_RUNS;
            double seconds[LAMP_RAYS], errors[LAMP_RAYS], times[LAMP_RUNS], unused, at;
            float *reference;
            ok = lamps_scene(context, kind, count);
            reference = ok ? lamps_render(context, 4096, 77, &unused) : NULL;
            ok = reference != NULL;
            for (rays = 0; rays < LAMP_RAYS && ok; rays++) {
                double sum = 0, squares = 0;
                for (run = 0; run < runs && ok; run++) {
                    float *radiance = lamps_render(context, lamp_rays[rays], (uint32_t)run, &times[run]);
                    ok = radiance != NULL;
                    for (i = 0; ok && i < LAMP_SIDE * LAMP_SIDE * 3; i++) {
                        squares += ((double)radiance[i] - reference[i]) * ((double)radiance[i] - reference[i]);
                        sum += reference[i];
                    }
                    free(radiance);
                }
                seconds[rays] = ok ? median(times, runs) : 0;
                errors[rays] = sqrt(squares * runs * LAMP_SIDE * LAMP_SIDE * 3) / sum;
            }
            free(reference);
            if (!ok) break;
            at = seconds_at(seconds, errors, LAMP_RAYS, lamp_target);
            if (!json)
                printf("| %s | %d | %.1f, %.2f %% | %.1f, %.2f %% | %.1f, %.2f %% | %.1f |\n", lamp_kinds[kind], count,
                       1e6 * seconds[0], 100 * errors[0], 1e6 * seconds[1], 100 * errors[1],
                              1e6 * seconds[2], 100 * errors[2], 1e6 * at);
            else printf("%s{\"kind\": \"%s\", \"triangles\": %d, \"microseconds_at_target\": %.4g}",
                        kind + number ? ", " : "", lamp_kinds[kind], count, 1e6 * at);
            fflush(stdout);
        }
    if (json) printf("]");
    sbl_destroy(context);
    return ok;
}

#endif
