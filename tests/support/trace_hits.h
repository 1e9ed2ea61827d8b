/* Casts single rays with shaders_embedded/traverse.glsl, and compares them with an independent ray caster
   (reference.h). Include after sbl.h, inside.h, test.h and reference.h. */
#ifndef TRACE_HITS_H
#define TRACE_HITS_H

/* Returns 1 if the ray passes an edge of the triangle so closely, or is so nearly parallel to it, that float rounding
   may decide about a hit. reach: magnitude of the coordinates, which determines the rounding */
static int trace_hits_graze(const v3 corners[3], v3 origin, v3 direction, double t, double reach) {
    v3 at = v3_mad(origin, direction, t), normal =
        v3_cross(v3_sub(corners[1], corners[0]), v3_sub(corners[2], corners[0]));
    double slack = 1e-5 * reach / fmax(fabs(v3_dot(v3_unit(normal), direction)), 1e-3);
    int k;
    for (k = 0; k < 3; k++) {
        v3 side = v3_sub(corners[(k + 1) % 3], corners[k]), to = v3_sub(at, corners[k]);
        double along = fmin(fmax(v3_dot(to, side) / v3_dot(side, side), 0), 1);
        if (v3_length(v3_sub(to, v3_scale(side, along))) < slack) return 1;
    }
    return 0;
}

typedef struct hits_compared {
    int rays, hits;
    int differ;       /* number of rays that hit another triangle at another distance */
    int ties;         /* another triangle at the same distance: triangles overlap, or a common edge is hit */
    int unexplained;  /* number of rays that differ although no edge of either triangle is near */
} hits_compared;

/* Casts the rays with both ray casters and compares the hits. Triangles are identified by their corners. */
static hits_compared trace_hits_compare(sbl_context *c, const ref_scene *scene, const float *rays, int count) {
    hits_compared out = { 0, 0, 0, 0, 0 };
    traced_hit *hits = (traced_hit *)malloc((size_t)count * sizeof *hits);
    int i, k;
    if (!hits) abort();
    if (!inside_cast(c, rays, count, hits)) { out.differ = out.unexplained = count; free(hits); return out; }
    for (i = 0; i < count; i++) {
        v3 origin = v3_from(rays + 8 * i), direction = v3_from(rays + 8 * i + 4), mine[3];
        ref_hit truth = ref_trace(scene, origin, direction, 0, 1e30, SBL_MATERIAL_HIDDEN_FROM_SENSORS);
        double apart = 0, reach = v3_length(origin), farther;
        int number = (int)hits[i].number;
        out.rays++;
        out.hits += number >= 0;
        if (number < 0 && truth.triangle < 0) continue;
        for (k = 0; k < 3 && number >= 0; k++) {
            mine[k] = v3_from(inside_triangle_corner(c, number, k));
            reach = fmax(reach, v3_length(mine[k]));
        }
        for (k = 0; k < 3 && truth.triangle >= 0; k++)
            reach = fmax(reach, v3_length(scene->triangles[truth.triangle].p[k]));
        if (number >= 0 && truth.triangle >= 0)
            for (k = 0; k < 3; k++)
                apart = fmax(apart, v3_length(v3_sub(mine[k], scene->triangles[truth.triangle].p[k])));
        if (number >= 0 && truth.triangle >= 0 && apart < 1e-6 * reach) continue;
        farther = number >= 0 && truth.triangle >= 0 ? fabs((double)hits[i].distance - truth.t) : 1e30;
        if (farther < 1e-5 * reach) { out.ties++; continue; }
        out.differ++;
        if (!(number >= 0 && trace_hits_graze(mine, origin, direction, (double)hits[i].distance, reach)) &&
            !(truth.triangle >= 0 && trace_hits_graze(scene->triangles[truth.triangle].p, origin, direction, truth.t,
                                                      reach))) out.unexplained++;
    }
    free(hits);
    return out;
}

/* Makes cosine-distributed rays, `each` of them from each of `points` pixels of the finished picture that show a
   surface. Writes 8 floats per ray. Returns the number of rays. */
static int trace_hits_rays(sbl_context *c, const sbl_picture_desc *view, int points, int each, uint64_t seed,
                           float *rays) {
    size_t pixels = (size_t)view->width * (size_t)view->height;
    float *position = (float *)malloc(pixels * 28), *normal = position + 3 * pixels, *id = position + 6 * pixels;
    int found = 0, count = 0, k, tries;
    if (!position) abort();
    if (sbl_read_channel(c, SBL_CHANNEL_POSITION, position, 3 * pixels) != SBL_SUCCESS ||
        sbl_read_channel(c, SBL_CHANNEL_NORMAL, normal, 3 * pixels) != SBL_SUCCESS ||
        sbl_read_channel(c, SBL_CHANNEL_ID, id, pixels) != SBL_SUCCESS) abort();
    for (tries = 0; found < points && tries < 100 * points; tries++) {
        size_t at = (size_t)(ref_random(&seed) * (double)pixels) % pixels;
        v3 p = v3_from(position + 3 * at), n = v3_from(normal + 3 * at), right, up;
        if (!(id[at] > 0)) continue;
        found++;
        right = v3_unit(v3_cross(fabs(n.z) < 0.9 ? v3_of(0, 0, 1) : v3_of(1, 0, 0), n));
        up = v3_cross(n, right);
        p = v3_mad(p, n, (double)inside_pixel_offset(c, at));
        for (k = 0; k < each; k++) {
            double u = ref_random(&seed), a = 6.283185307 * ref_random(&seed);
            v3 d = v3_add(v3_scale(n, sqrt(1 - u)),
                          v3_add(v3_scale(right, sqrt(u) * cos(a)), v3_scale(up, sqrt(u) * sin(a))));
            float *ray = rays + 8 * (size_t)count++;
            ray[0] = (float)p.x; ray[1] = (float)p.y; ray[2] = (float)p.z; ray[3] = 0;
            ray[4] = (float)d.x; ray[5] = (float)d.y; ray[6] = (float)d.z; ray[7] = 0;
        }
    }
    free(position);
    return count;
}

#endif
