/* Draws the overlay of sbl_view: the rays, lamps and sums of a sensor, and the marks of the lights. Include after
   view_draw.h, view_camera.h and sensor_disc.h. */
#ifndef VIEW_OVERLAY_H
#define VIEW_OVERLAY_H

enum { OVERLAY_DISC = 128, OVERLAY_LINES = 8192 };

static struct overlay {
    view_corner corners[2 * OVERLAY_LINES];
    int count;
    float world_to_view[16], view_to_clip[16];  /* the camera of the shown picture */
    int has_sensor;
    sbl_sensor sensor;                          /* its arrays of rays and lamps belong to sbl.h */
    double from_lamps[3], from_surroundings[3];
    unsigned char disc[OVERLAY_DISC * OVERLAY_DISC * 3];
} overlay;

static void overlay__line(const double from[3], const double to[3], const float color[4]) {
    view_corner *c = &overlay.corners[overlay.count];
    if (overlay.count + 2 > 2 * OVERLAY_LINES) return;
    view_project(overlay.world_to_view, overlay.view_to_clip, from, c[0].position);
    view_project(overlay.world_to_view, overlay.view_to_clip, to, c[1].position);
    memcpy(c[0].color, color, sizeof c->color);
    memcpy(c[1].color, color, sizeof c->color);
    overlay.count += 2;
}

/* Returns the distance along a ray to the plane of the triangle of a lamp, or 0 if the triangle is not found.
   lamp->number counts only triangles with an area. */
static double overlay__to_triangle(const sbl_scene_desc *scene, const sbl_sensor_lamp *lamp, const double from[3],
                                   const double way[3]) {
    const sbl_mesh *m = &scene->meshes[lamp->mesh];
    double p[3][3], a[3], b[3], n[3], to[3];
    int i, k, number = lamp->number;
    if (m->indices.type != SBL_UINT32) return 0;  /* the ground of a studio has no 32-bit indices */
    for (i = 0; i + 2 < m->index_count; i += 3) {
        for (k = 0; k < 3; k++) studio__corner(m, i + k, p[k]);
        for (k = 0; k < 3; k++) { a[k] = p[1][k] - p[0][k]; b[k] = p[2][k] - p[0][k]; to[k] = p[0][k] - from[k]; }
        view_cross(a, b, n);
        if (view_dot(n, n) > 0 && number-- == 0) break;
    }
    if (i + 2 >= m->index_count || fabs(view_dot(n, way)) <= 0) return 0;
    return view_dot(n, to) / view_dot(n, way);
}

/* Returns the length at which a ray is drawn. far_away: length of rays that hit nothing */
static double overlay__length(const sbl_scene_desc *scene, const sbl_sensor_ray *r, const double from[3],
                              const double way[3], double far_away) {
    const sbl_sensor_lamp *lamp = r->lamp >= 0 ? &overlay.sensor.lamps[r->lamp] : NULL;
    double length = fabs((double)r->distance), to[3];
    int k;
    if (lamp && lamp->kind == SBL_LAMP_TRIANGLE) length = overlay__to_triangle(scene, lamp, from, way);
    if (lamp && lamp->kind == SBL_LAMP_LIGHT && lamp->number < scene->light_count &&
        scene->lights[lamp->number].kind != SBL_LIGHT_DIRECTIONAL) {
        for (k = 0; k < 3; k++) to[k] = (double)scene->lights[lamp->number].position[k] - from[k];
        length = view_dot(to, way);
    }
    return length > 0 && length < far_away ? length : far_away;
}

static const float overlay_open[4] = { 1, 0.85f, 0.2f, 0.8f }, overlay_blocked[4] = { 1, 0.1f, 0.1f, 0.8f };

/* Adds the lines of the rays of the sensor. Rays over the hemisphere have the colour of the light that they find. Rays
   to lamps are yellow if the lamp is visible and red if they are blocked. factor: the exposure */
static void overlay_rays(const sbl_scene_desc *scene, double far_away, float factor) {
    const sbl_sensor *s = &overlay.sensor;
    double from[3], way[3], to[3];
    int i, k;
    for (k = 0; k < 3; k++) from[k] = (double)s->position[k];
    for (i = 0; i < s->ray_count; i++) {
        const sbl_sensor_ray *r = &s->rays[i];
        const float *light = r->radiance;
        float color[4];
        double length;
        for (k = 0; k < 3; k++) way[k] = (double)r->direction[k];
        length = overlay__length(scene, r, from, way, far_away);
        for (k = 0; k < 3; k++) to[k] = from[k] + length * way[k];
        for (k = 0; k < 3; k++) {
            const float x = sqrtf(light[k] * factor);
            color[k] = 0.15f + 0.85f * (x < 1 ? x : 1);
        }
        color[3] = 0.55f;
        if (r->lamp >= 0)
            memcpy(color, light[0] > 0 || light[1] > 0 || light[2] > 0 ? overlay_open : overlay_blocked, sizeof color);
        overlay__line(from, to, color);
    }
}

/* Adds a line to each light of the scene among the lamps of the sensor, because lights without a size have no ray in
   the list. */
static void overlay_lights(const sbl_scene_desc *scene, double far_away) {
    double from[3], to[3];
    int i, k;
    for (k = 0; k < 3; k++) from[k] = (double)overlay.sensor.position[k];
    for (i = 0; i < overlay.sensor.lamp_count; i++) {
        const sbl_sensor_lamp *lamp = &overlay.sensor.lamps[i];
        const sbl_light *light;
        if (lamp->kind != SBL_LAMP_LIGHT || lamp->number >= scene->light_count) continue;
        light = &scene->lights[lamp->number];
        if (light->kind == SBL_LIGHT_DIRECTIONAL) {
            for (k = 0; k < 3; k++) to[k] = (double)light->direction[k];
            view_unit(to);
            for (k = 0; k < 3; k++) to[k] = from[k] - far_away * to[k];
        } else for (k = 0; k < 3; k++) to[k] = (double)light->position[k];
        overlay__line(from, to, lamp->open ? overlay_open : overlay_blocked);
    }
}

/* Adds a mark at a point: three crossed lines of equal length on the screen. */
static void overlay_mark(const double at[3], double reach, const float color[4]) {
    double from[3], to[3];
    int i;
    for (i = 0; i < 3; i++) {
        memcpy(from, at, sizeof from);
        memcpy(to, at, sizeof to);
        from[i] -= reach;
        to[i] += reach;
        overlay__line(from, to, color);
    }
}

/* Inspects the sensor at a pixel, stores it for drawing, and prints it. Returns 0 on failure, such as lack of
   memory. */
static int overlay_take(sbl_context *context, const int pixel[2], float factor) {
    sbl_sensor *s = &overlay.sensor;
    const size_t texels = (size_t)s->sheet_width * (size_t)s->sheet_height;
    float *radiance = (float *)malloc(texels * 4 * sizeof *radiance);
    float *weights = (float *)malloc(texels * sizeof *weights);
    float *disc = (float *)malloc(sizeof overlay.disc * sizeof *disc);
    sbl_result result = SBL_ERROR_OUT_OF_MEMORY;
    double sum[3] = { 0, 0, 0 };
    size_t i;
    if (radiance && weights && disc)
        result = sbl_inspect_sensor(context, pixel[0], pixel[1], s, radiance, weights, texels);
    for (i = 0; i < 3 * texels && result == SBL_SUCCESS; i++)
        sum[i % 3] += (double)weights[i / 3] * (double)radiance[i / 3 * 4 + i % 3];
    if (result == SBL_SUCCESS) {
        sensor_disc(s, OVERLAY_DISC, disc);
        sbl_encode_srgb8(overlay.disc, disc, sizeof overlay.disc, factor);
        sensor_print(s, pixel, sum);
        fflush(stdout);
        for (i = 0; i < 3; i++) {
            overlay.from_lamps[i] = (double)s->from_lamps[i];
            overlay.from_surroundings[i] = (double)s->from_surroundings[i];
        }
    }
    free(radiance);
    free(weights);
    free(disc);
    return overlay.has_sensor = result == SBL_SUCCESS;
}

/* Draws the disc of the sensor, and next to it its sums as red, green and blue bars: from lamps, from surroundings, and
   in total. height: of the window */
static void overlay_draw_sums(int height) {
    static const float colors[3][4] = { { 0.9f, 0.25f, 0.2f, 1 }, { 0.3f, 0.8f, 0.3f, 1 }, { 0.3f, 0.45f, 1, 1 } };
    static const float black[4] = { 0, 0, 0, 1 };
    const int size = height / 4 < OVERLAY_DISC ? height / 4 : OVERLAY_DISC, rect[4] = { 8, 12, size, size };
    const int left = rect[0] + size + 6, thick = size > 60 ? size / 32 : 1, most_bars = 15 * thick;
    double most = 0;
    int i, k;
    gl.BindTexture(GL_TEXTURE_2D, view_gl.disc);
    gl.TexImage2D(GL_TEXTURE_2D, 0, GL_RGB8, OVERLAY_DISC, OVERLAY_DISC, 0, GL_RGB, GL_UNSIGNED_BYTE, overlay.disc);
    view_draw_texture(view_gl.disc, rect, 0);
    for (k = 0; k < 3; k++) most = fmax(most, overlay.from_lamps[k] + overlay.from_surroundings[k]);
    view_draw_rect(left - 2, rect[1], size + 4, most_bars, black);
    for (i = 0; i < 3; i++)
        for (k = 0; k < 3; k++) {
            const double value = (i != 1 ? overlay.from_lamps[k] : 0) + (i != 0 ? overlay.from_surroundings[k] : 0);
            view_draw_rect(left, rect[1] + thick * (13 - 5 * i - k), most > 0 ? (int)(size * value / most) : 0, thick,
                           colors[k]);
        }
}

#endif
