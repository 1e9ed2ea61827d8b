// Computes the surface points that the camera's pixels or the texels of a lightmap show.
uniform usampler2D triangles;  // output of visibility_fragment.glsl; lightmaps: see SBL__ATLAS_WORDS
uniform float facet_limit;     // in pixels; for lightmaps, in world units; 0: not used. Triangles whose smallest
                               // height, seen face-on, is below facet_limit get the geometric normal; above twice
                               // facet_limit, the shading normal; in between, a mixture
layout(location = 0) out vec4 out_position;          // w: sbl_Surface.reach, see surface.glsl
layout(location = 1) out vec4 out_normal;
layout(location = 2) out vec4 out_geometric_normal;
layout(location = 3) out vec4 out_albedo;            // w: 2 if a blurred mirror shows the surface
                                                     // (blurs_pixel), otherwise 1; 0: no surface
layout(location = 4) out vec4 out_emission;
layout(location = 5) out uint out_id;
#ifdef SBL_SPECULAR
const float SBL_SMOOTH_ROUGHNESS = 0.6;      // facet_limit does not affect smoother surfaces
layout(location = 6) out vec4 out_specular;  // rgb: directional albedo of the specular lobe, 0: no lobe; w:
                                             // sbl_Mirrored.stored
layout(location = 7) out vec4 out_lobe;      // see sbl__reflections_unpack; y is negative if the surface has no
                                             // lobe
#endif
// In SBL_MODE_GI, w of normal, geometric normal and emission hold red, green and blue of the stored R. On surfaces
// with SBL_NO_SENSORS, w of normal is -1 - red.

#ifdef SBL_BOUNCED
// Returns the mean of the stored R at 5 x 5 points that are spread over about the area of a cell. Points where R
// is 0 do not count. Surfaces without sensors, and surfaces that a pane mirrors, show this mean, because no
// interpolation between sensors hides the borders of their cells. points: 25; or 0 if the result is not needed and
// shall be 0
vec3 sbl_stored_smooth(int number, sbl_Surface s, int points) {
    mat3 frame = sbl_frame(s.geometric_normal);
    float step = 0.25 / per_cell, weight = 0.0;
    vec3 sum = vec3(0);
    for (int i = 0; i < points; i++) {
        vec3 at = s.position + step * (frame * vec3(i % 5 - 2, i / 5 - 2, 0));
        vec3 light = sbl_stored(number, s.back, at, SBL_UNBOUNDED);
        sum += light;
        weight += max(light.r, max(light.g, light.b)) > 0.0 ? 1.0 : 0.0;
    }
    return sum / max(weight, 1.0);
}
#endif

#ifndef SBL_LIGHTMAP
// Applies facet_limit to the surface that a camera ray meets. bumpy: true: the surface has a normal map
void sbl_apply_facet_limit(inout sbl_Surface s, vec3 origin, vec3 direction, bool bumpy) {
    // width of a pixel at the surface, in world units
    float pixel = length(origin_y + distance(s.position, origin) / length(direction) * direction_y);
    // true: small triangles keep the shading normal, which reflections and normal maps need
    bool smooth_normal = bumpy;
#ifdef SBL_SPECULAR
    smooth_normal = bumpy || s.material.roughness >= 0.0 && s.material.roughness < SBL_SMOOTH_ROUGHNESS;
#endif
    if (facet_limit > 0.0 && !smooth_normal)
        s.normal = normalize(mix(s.geometric_normal, s.normal,
                                 clamp(s.least_height / (facet_limit * pixel) - 1.0, 0.0, 1.0)));
}

#ifdef SBL_NORMAL_MAPS
bool sbl_is_bumpy(int object) { return sbl_object_normal_texture(object).w != 0u; }
#else
bool sbl_is_bumpy(int object) { return false; }
#endif
#endif

#if defined(SBL_SPECULAR) && !defined(SBL_LIGHTMAP)
uniform float ray_start;                // a camera ray begins at its origin + ray_start * its direction
uniform bool draws_sample;              // true: the pass draws an anti-aliasing sample; false: the pixels' centres
uniform vec2 sample_point;              // random point of the sample in the unit square, see sbl_mirrored
bool blurs_pixel = false;               // true: the ray has met a mirror that blurs what it shows
const vec2 SBL_POINT_STEP = vec2(0.377, 0.285);  // distance between the points of successive rays, see sbl_follow
// Two rays leave each mirror and each pane: the main ray `next`, and the ray `aside`, see sbl_leave_surface.
const int SBL_ASIDE_MIRRORS = 3;        // the ray `aside` is reflected by at most this many surfaces of metal
const int SBL_ASIDE_HITS = 8;           // at most this many surfaces reflect the ray `aside` or let it pass
const float SBL_ASIDE_ROUGH = 0.5;      // rougher surfaces do not reflect the ray `aside`; it ends there
const int SBL_MIRRORS = 8;              // a pixel shows surfaces by way of at most this many mirrors
const float SBL_PANE = 0.499;           // a surface is a pane if it transmits at least this fraction of light
const int SBL_PANES = 56;               // up to this many panes do not count as mirrors (SBL_MIRRORS); further
                                        // panes do

// The surface that a pixel shows in mirrors and behind panes
struct sbl_Mirrored {
    vec3 direction;   // direction of the last ray
    vec3 throughput;  // product of the reflectances of the mirrors and transmittances of the panes on the way
    vec3 emission;    // emission of the mirrors and panes, light that panes reflect, and light of the sky
    float stored;     // luminance of the stored light in `emission`
    int number;       // index in the scene of the triangle that the last ray hits; -1: the camera ray hits nothing
    bool sky;         // true: the last ray hits nothing; the surface is then the last mirror or pane
};

// Returns true if the camera ray misses the triangle that the rasteriser found in the pixel. The rasteriser rounds
// corners to parts of a pixel, so that the pixel may show a triangle beside its centre. At a silhouette, this may
// be a triangle that is seen edge-on, or a back face, which is dark inside a closed mesh.
bool sbl_misses(int triangle, vec3 origin, vec3 direction) {
    vec3 b = sbl_on_plane(sbl_facet(triangle), origin, direction);
    return b.z == 0.0 || !(min(min(b.x, b.y), 1.0 - b.x - b.y) >= 0.0);
}

// Replaces the surface s, whose triangle is m.number, by what the camera ray hits; see sbl_misses.
void sbl_correct(inout sbl_Surface s, inout sbl_Mirrored m, sbl_Hit hit, vec3 origin, vec3 direction) {
    bool hits = hit.triangle >= 0;
    if (!hits) m.number = -1;
    for (int once = 0; once < (hits ? 1 : 0); once++) {
        sbl_Surface found = sbl_surface_at(sbl_facet(hit.number), hit.b1, hit.b2, direction);
        // A surface that is hidden from the camera must not replace s.
        if ((sbl_object_flags(found.object) & SBL_HIDDEN_FROM_CAMERA) != 0u) break;
        sbl_apply_facet_limit(found, origin, direction, sbl_is_bumpy(found.object));
        m.number = hit.number;
        s = found;
    }
}

// Returns the stored light that a surface reflects. number: index of its triangle in the scene; only_diffuse:
// true: without its specular lobe
vec3 sbl_stored_radiance(sbl_Surface s, int number, bool only_diffuse) {
#ifdef SBL_BOUNCED
    if (only_diffuse)
        return sbl_reflected_diffuse(s.material, sbl_stored(number, s.back, s.position, SBL_UNBOUNDED));
    return sbl_reflected(s.material, sbl_stored_smooth(number, s, 25));
#else
    return vec3(0);
#endif
}

// sbl_follow may end at a surface that lets light pass, and then does not find what is behind it. Returns a
// substitute: the transmitted fraction, times the stored light of the surface itself.
vec3 sbl_passing_rest(sbl_Surface s, int number, vec3 direction) {
    vec3 rest = sbl_passing(s.object, s.material, clamp(-dot(s.normal, direction), 0.0, 1.0));
#ifdef SBL_BOUNCED
    bool some = rest != vec3(0);
    for (int once = 0; once < (some ? 1 : 0); once++)
        rest *= sbl_stored(number, s.back, s.position, SBL_UNBOUNDED);
    return rest;
#else
    return vec3(0);
#endif
}

bool sbl_is_mirror(sbl_Material m) {
    return m.roughness >= 0.0 && m.roughness < SBL_MIRROR_SEEN &&
           max(m.diffuse.r, max(m.diffuse.g, m.diffuse.b)) <= SBL_MIRROR_DIFFUSE;
}

// Returns the direction in which the surface s mirrors a ray, bent upwards if the interpolated normal would lead
// it into the surface. If the mirror blurs, samples the direction from its lobe, and sets weight to the fraction
// of light that is reflected. point: uniform point in the unit square from which the direction is sampled
vec3 sbl_mirrored(sbl_Surface s, vec3 direction, vec2 point, inout vec3 weight) {
    vec3 mirrored = direction - 2.0 * dot(s.normal, direction) * s.normal;
#ifdef SBL_MIRRORS_BLUR
    bool blurs = sbl_is_mirror(s.material) && s.material.roughness >= SBL_MIRROR;
    blurs_pixel = blurs_pixel || blurs;
    for (int once = 0; once < (blurs && draws_sample ? 1 : 0); once++) {
        sbl_Lobe l = sbl_lobe_of(s.normal, -direction, s.material.reflectance, s.material.roughness);
        mirrored = sbl_lobe_sample(l, point, weight);
        weight *= s.material.opacity;
    }
#endif
    float below = dot(mirrored, s.geometric_normal);
    if (below < SBL_GRAZING) mirrored += (SBL_GRAZING - below) * s.geometric_normal;
    return normalize(mirrored);
}

// A ray that leaves a mirror or a pane
struct sbl_Leaving {
    vec3 origin, direction;
    vec3 weight;             // factor of the light that the ray finds; 0: no ray
};

sbl_Leaving sbl_leaving(sbl_Surface s, bool through, vec3 direction, vec3 weight) {
    float side = through ? -1.0 : 1.0;
    return sbl_Leaving(s.position + side * SBL_OFFSET * s.reach * s.geometric_normal, direction, weight);
}

// Makes the two rays that leave the surface s. Returns the main ray, with which sbl_follow continues: it passes
// through a pane, and is reflected by any other surface. Its weight is 0 if the surface is neither a mirror nor a
// pane. aside: the other ray, which is reflected by a pane, and passes through any other surface that transmits
// light. Further surfaces let the ray `aside` pass or, if they are metal, reflect it; at all others it ends, with
// the stored light there. point: see sbl_mirrored
sbl_Leaving sbl_leave_surface(sbl_Surface s, vec3 direction, vec2 point, out sbl_Leaving aside, out bool pane) {
    float cosine = clamp(-dot(s.normal, direction), 0.0, 1.0);
    vec3 passing = sbl_passing(s.object, s.material, cosine), weight = vec3(0);
    pane = max(passing.r, max(passing.g, passing.b)) >= SBL_PANE;
    if (pane && s.material.roughness >= 0.0) weight = sbl_lobe_reflected(s.material, cosine, vec3(1));
    if (!pane && sbl_is_mirror(s.material)) weight = sbl_mirror_reflectance(s.material, cosine);
    sbl_Leaving through = sbl_leaving(s, true, direction, passing);
    vec3 mirror_direction = sbl_mirrored(s, direction, point, weight);
    sbl_Leaving mirrored = sbl_leaving(s, false, mirror_direction, weight);
    aside = mirrored;
    if (pane) return through;
    aside = through;
    return mirrored;
}

// Returns the ray with which the ray `aside` continues: reflected by metal or, if `through` is set to true,
// through a surface that lets some light pass. Its weight is 0 if the ray ends. In anti-aliasing samples, metal of
// a roughness from SBL_MIRROR to SBL_POLISHED reflects the ray in a random direction of its lobe.
// hits: number of surfaces at which the ray continued before. point: see sbl_mirrored
sbl_Leaving sbl_aside(sbl_Surface s, sbl_Leaving ray, int hits, vec2 point, out bool through) {
    float cosine = -dot(s.normal, ray.direction);
    vec3 passing = sbl_passing(s.object, s.material, cosine);
    float most = max(passing.r, max(passing.g, passing.b));
    bool reflects = sbl_is_strong(s.material, s.material.reflectance) && s.material.roughness < SBL_ASIDE_ROUGH &&
                  hits < SBL_ASIDE_MIRRORS && most < SBL_PANE;
    through = most > 0.0 && hits < SBL_ASIDE_HITS && !reflects;
    if (through) return sbl_leaving(s, true, ray.direction, ray.weight * passing);
    vec3 weight = reflects ? sbl_lobe_reflected(s.material, cosine, ray.weight) : vec3(0);
    vec3 direction = ray.direction - 2.0 * dot(s.normal, ray.direction) * s.normal;
#ifdef SBL_MIRRORS_BLUR
    bool blurs = reflects && s.material.roughness >= SBL_MIRROR && s.material.roughness < SBL_POLISHED;
    blurs_pixel = blurs_pixel || blurs;
    for (int once = 0; once < (blurs && draws_sample ? 1 : 0); once++) {
        sbl_Lobe l = sbl_lobe_of(s.normal, -ray.direction, s.material.reflectance, s.material.roughness);
        direction = sbl_lobe_sample(l, point, weight);
        weight *= s.material.opacity * ray.weight;
    }
#endif
    if (dot(direction, s.geometric_normal) <= 0.0) weight = vec3(0);
    return sbl_leaving(s, false, direction, weight);
}

// Adds the stored light that the surface s reflects, times weight. number, only_diffuse: see sbl_stored_radiance
void sbl_show_stored(inout sbl_Mirrored m, sbl_Surface s, int number, bool only_diffuse, vec3 weight) {
    vec3 light = m.throughput * weight * sbl_stored_radiance(s, number, only_diffuse);
    m.emission += light;
    m.stored += dot(light, vec3(SBL_LUMINANCE_WEIGHTS));
}

// The ray that sbl_follow traces next
const int SBL_CAMERA_RAY = 0, SBL_ASIDE_RAY = 1, SBL_NEXT_RAY = 2;

// Follows the camera ray while the surface s, which has triangle `number`, is a mirror or a pane. Replaces s by
// the surface that the last ray hits. Each iteration traces one ray. If the camera ray misses the triangle, it is
// traced first, and s becomes the surface that it hits. At each mirror or pane, the ray `aside` is traced until it
// ends, then the ray `next`, which leads to the next mirror or pane. Drivers compile a copy of sbl_trace for each
// call, so all rays share one call.
sbl_Mirrored sbl_follow(inout sbl_Surface s, int number, vec3 origin, vec3 direction) {
    sbl_Mirrored m = sbl_Mirrored(normalize(direction), vec3(1), vec3(0), 0.0, number, false);
    sbl_Leaving next, aside;
    int turn = sbl_misses(number, origin, direction) ? SBL_CAMERA_RAY : SBL_ASIDE_RAY;
    bool continues = true;
    int hits = 0;     // number of surfaces at which the ray `aside` has continued
    int panes = 0;    // number of panes that the ray `next` has passed
    int mirrors = 0;  // number of surfaces that the ray `next` has left, without the first SBL_PANES panes
    while (mirrors < SBL_MIRRORS && (continues || hits > 0)) {
        bool is_aside = turn == SBL_ASIDE_RAY;
        int rays = 2 * mirrors + (turn == SBL_NEXT_RAY ? 1 : 0) + hits;
        vec2 point = fract(sample_point + float(rays) * SBL_POINT_STEP);
        if (is_aside && hits == 0) {
            bool pane;
            next = sbl_leave_surface(s, m.direction, point, aside, pane);
            continues = next.weight != vec3(0);
            if (continues && pane && panes++ < SBL_PANES) mirrors--;  // does not count as a mirror
            for (int once = 0; once < (continues && pane ? 1 : 0); once++)
                sbl_show_stored(m, s, m.number, true, vec3(1));
            if (continues) m.emission += m.throughput * s.emission;
        }
        sbl_Leaving ray = next;
        if (is_aside) ray = aside;
        if (turn == SBL_CAMERA_RAY) ray = sbl_Leaving(origin + ray_start * direction, direction, vec3(1));
        if (ray.weight == vec3(0)) {  // only the ray `aside` may be missing: without `next`, the loop ends
            turn = SBL_NEXT_RAY;
            continue;
        }
        sbl_Hit hit = sbl_trace(ray.origin, ray.direction, SBL_UNBOUNDED, SBL_RAY_SOLID);
        if (turn == SBL_CAMERA_RAY) {
            sbl_correct(s, m, hit, origin, direction);
            continues = m.number >= 0;
            turn = SBL_ASIDE_RAY;
            continue;
        }
        bool is_sky = hit.triangle < 0;
        sbl_Surface found = s;
        if (!is_sky) found = sbl_surface(hit.number, ray.origin, ray.direction);
        vec3 light = is_sky ? sky + sbl_sky_smooth(ray.direction) : vec3(0);
        sbl_Leaving further = ray;
        further.weight = vec3(0);
        bool through = false;
        if (is_aside && !is_sky) further = sbl_aside(found, ray, hits, point, through);
        bool reflects = further.weight != vec3(0) && !through;
        for (int once = 0; once < (is_aside && !is_sky && !reflects ? 1 : 0); once++)
            sbl_show_stored(m, found, hit.number, false, ray.weight);
        hits = further.weight == vec3(0) ? 0 : hits + 1;
        if (hits > 0) {
            m.emission += m.throughput * ray.weight * found.emission;
            aside = further;
            continue;  // the next iteration traces `further`
        }
        if (is_aside && !is_sky) light = found.emission;
        m.emission += m.throughput * ray.weight * light;
        turn = is_aside ? SBL_NEXT_RAY : SBL_ASIDE_RAY;
        if (is_aside) continue;
        mirrors++;
        m.direction = ray.direction;
        m.throughput *= ray.weight;
        m.sky = is_sky;
        continues = !is_sky;
        if (is_sky) continue;
        m.number = hit.number;
        s = found;
    }
    if (continues && m.number >= 0) m.emission += m.throughput * sbl_passing_rest(s, m.number, m.direction);
    return m;
}

// Packs two numbers from 0 to 1 into one.
float sbl_pack_two(float a, float b) {
    vec2 steps = floor(clamp(vec2(a, b), 0.0, 1.0) * SBL_LOBE_STEPS + 0.5);
    return steps.x + (SBL_LOBE_STEPS + 1.0) * steps.y;
}

// Maps a unit vector to a point in the square -1 .. 1: octahedral mapping (Cigolle et al. 2014, "A Survey of
// Efficient Representations for Independent Unit Vectors").
vec2 sbl_pack_direction(vec3 v) {
    vec2 p = v.xy / (abs(v.x) + abs(v.y) + abs(v.z));
    vec2 turned = (1.0 - abs(p.yx)) * vec2(p.x < 0.0 ? -1 : 1, p.y < 0.0 ? -1 : 1);
    return v.z < 0.0 ? turned : p;
}
#endif

void main() {
    uvec4 texel = texelFetch(triangles, ivec2(gl_FragCoord.xy), 0);
    uint triangle = texel.x;
    out_position = out_normal = out_geometric_normal = out_albedo = out_emission = vec4(0);
    out_id = 0u;
#ifdef SBL_SPECULAR
    out_specular = vec4(0);
    out_lobe = vec4(0, -1, 0, 0);
#endif
    if (triangle > 0u) {
#ifdef SBL_LIGHTMAP
        sbl_Surface s = sbl_surface_front(int(triangle) - 1, abs(uintBitsToFloat(texel.y)),
                                          uintBitsToFloat(texel.z));
        s.id = texel.w;
        if (facet_limit > 0.0 && (texel.y & SBL_ATLAS_MARK) != 0u)
            s.normal = normalize(mix(s.geometric_normal, s.normal,
                                     clamp(s.least_height / facet_limit - 1.0, 0.0, 1.0)));
#else
        vec3 origin = sbl_camera_origin(), direction = sbl_camera_direction();
#ifdef SBL_NORMAL_MAPS
        sbl_Facet f = sbl_facet(int(triangle) - 1);
        bool bumpy = sbl_is_bumpy(int(sbl_vertex_object(f.v.x)));
        for (int once = 0; once < (bumpy ? 1 : 0); once++) {
            vec2 uv = sbl_uv_on_plane(f, origin, direction);
            pixel_x = sbl_uv_on_plane(f, origin + origin_x, direction + direction_x) - uv;
            pixel_y = sbl_uv_on_plane(f, origin + origin_y, direction + direction_y) - uv;
        }
#else
        const bool bumpy = false;
#endif
        sbl_Surface s = sbl_surface(int(triangle) - 1, origin, direction);
#ifdef SBL_NORMAL_MAPS
        pixel_x = pixel_y = vec2(0);  // unknown for surfaces that sbl_follow finds in mirrors
#endif
        sbl_apply_facet_limit(s, origin, direction, bumpy);
#endif
#if defined(SBL_SPECULAR) && !defined(SBL_LIGHTMAP)
        sbl_Mirrored seen = sbl_follow(s, int(triangle) - 1, origin, direction);
        triangle = uint(seen.number + 1);
        if (triangle == 0u) return;
#endif
        out_position = vec4(s.position, s.reach);
        out_normal = vec4(s.normal, 0);
        out_geometric_normal = vec4(s.geometric_normal, 0);
        out_albedo = vec4(s.material.albedo, 1);
        out_emission = vec4(s.emission, 0);
        out_id = s.id;
#if defined(SBL_SPECULAR) && !defined(SBL_LIGHTMAP)
        vec3 shown = s.material.albedo;
        if (s.material.roughness >= 0.0) {
            float cosine = clamp(-dot(s.normal, seen.direction), 1e-3, 1.0);
            vec3 reflectance = s.material.reflectance;
            out_specular = vec4(sbl_lobe_shown(s.material, cosine), 1);
            out_lobe = vec4(sbl_pack_two(reflectance.r, reflectance.g),
                            sbl_pack_two(reflectance.b, s.material.roughness),
                            sbl_pack_direction(-seen.direction));
            shown = sbl_diffuse_albedo(s.material, cosine);
        }
        if (seen.sky) {
            out_specular = vec4(0);
            out_lobe.y = -1.0;
            shown = out_emission.rgb = vec3(0);
        }
        out_specular = vec4(seen.throughput * out_specular.rgb, seen.stored);
        shown *= seen.throughput;
        out_albedo = vec4(shown, blurs_pixel ? 2 : 1);
        out_emission.rgb = seen.emission + seen.throughput * out_emission.rgb;
#endif
#ifdef SBL_BOUNCED
        bool excluded = (sbl_object_flags(s.object) & SBL_NO_SENSORS) != 0u;
        vec3 light = sbl_stored(int(triangle) - 1, s.back, s.position, SBL_UNBOUNDED);
        vec3 smooth_light = sbl_stored_smooth(int(triangle) - 1, s, excluded ? 25 : 0);
        if (excluded) light = smooth_light;
        out_normal.w = excluded ? -1.0 - light.r : light.r;
        out_geometric_normal.w = light.g;
        out_emission.w = light.b;
#endif
    }
}
