// Sends a part of a sensor's rays to lamps that it may see in flat surfaces with a narrow lobe, such as polished
// tiles. Other rays find these highlights by chance only, and show them as specks. The directions change, but not
// the light: the weight of a ray is 1 / its pdf, whichever way its direction was chosen (balance heuristic, Veach
// 1997).
#if defined(SBL_BOUNCED) && defined(SBL_SPECULAR) && !defined(SBL_LOBE)
#define SBL_SEES_MIRRORED
uniform int mirrored_count;               // number of records in the scene
// scouts: true: the rays are scouts (see >>guide in sbl.h). None goes to a mirrored lamp, so that all keep the
// directions from which guides are made. Their weights still say how well rays to mirrored lamps find light, so
// that guides send few further rays to these lamps
uniform bool scouts;

const int SBL_MIRRORED = 4;               // a sensor uses this many mirrored lamps, which are the brightest
const float SBL_MIRRORED_RAYS = 0.3;      // largest fraction of the rays that go to mirrored lamps. It is smaller
                                          // for small mirrors, and for wide highlights, which other rays also find
const float SBL_MIRRORED_FRACTION = 4.0;  // SBL_MIRRORED_RAYS is multiplied by min(1, this * m / d). m: light of
                                          // the mirrored lamps; d: unblocked direct light of the brightest lamp
const float SBL_MIRRORED_WIDTH2 = 1e-6;   // lower limit of squared widths, below which float rounding would show
const float SBL_MIRRORED_NARROW = 0.004;  // squared width up to which a highlight is narrow
const float SBL_MIRRORED_SPAN = 16.0;     // (diagonal of a mirror / width of the highlight that it covers)^2
vec4 mirrored_direction[SBL_MIRRORED];    // xyz: unit direction to the image of the lamp; w: squared width
float mirrored_chance[SBL_MIRRORED];      // probability of each, in descending order; the sum is 1
float mirrored_rays = 0.0;                // fraction of this sensor's rays that go to mirrored lamps

// Inserts a mirrored lamp into the sorted list, which keeps the lamps with the largest chances.
void sbl_mirrored_add(vec4 direction, float chance) {
    for (int k = 0; k < SBL_MIRRORED; k++) {
        bool before = chance > mirrored_chance[k];
        vec4 next_direction = before ? mirrored_direction[k] : direction;
        float next = before ? mirrored_chance[k] : chance;
        if (before) mirrored_direction[k] = direction;
        if (before) mirrored_chance[k] = chance;
        direction = next_direction;
        chance = next;
    }
}

// Chooses the mirrored lamps of a sensor. The squared width of a highlight is the sum of the squared widths of
// the lobe and of the lamp, in radians, as seen from the sensor. A deviation of the ray by x turns the half
// vector by x / 2 * (distance to the lamp's image) / (distance from the mirror to this image).
void sbl_mirrored_begin(vec3 from, vec3 normal) {
    for (int k = 0; k < SBL_MIRRORED; k++) {
        mirrored_direction[k] = vec4(normal, 1);
        mirrored_chance[k] = 0.0;
    }
    float most = 0.0, brightest = 0.0;  // most: factor of SBL_MIRRORED_RAYS
    for (int i = 0; i < mirrored_count; i++) {
        bool distant = sbl_mirrored_distant(i) != 0u;
        vec3 mirror_normal = sbl_mirrored_normal(i);
        vec3 to = sbl_mirrored_middle(i) - (distant ? vec3(0) : from);
        float away = max(length(to), SBL_DIVISOR_LEAST), radius = sbl_mirrored_radius(i);
        vec3 to_image = to / away;
        float cosine = dot(normal, to_image), mirror_cosine = -dot(mirror_normal, to_image);
        float height = dot(mirror_normal, from) - sbl_mirrored_offset(i), lamp = min(radius / away, 1.0);
        vec3 size = sbl_mirrored_high(i) - sbl_mirrored_low(i);
        float least = SBL_MIRRORED_HEIGHT * (distant ? length(size) : away);
        if (height <= least || mirror_cosine <= 0.0 || cosine + lamp <= 0.0) continue;
        float to_mirror = height / mirror_cosine;
        float lobe = 2.0 * sbl_mirrored_alpha(i) * (distant ? 1.0 : max(1.0 - to_mirror / away, 0.0));
        float width2 = max(lobe * lobe + lamp * lamp, SBL_MIRRORED_WIDTH2);
        vec3 hit = from + to_mirror * to_image, margin = vec3(to_mirror * sqrt(width2));
        vec3 outside = max(sbl_mirrored_low(i) - margin - hit, hit - margin - sbl_mirrored_high(i));
        if (max(outside.x, max(outside.y, outside.z)) > 0.0) continue;
        // fraction of the highlight that the mirror may cover, from the diagonal of its bounds
        float covered = min(dot(size, size) / (SBL_MIRRORED_SPAN * to_mirror * to_mirror * width2), 1.0);
        most = max(most, covered * min(SBL_MIRRORED_NARROW / width2, 1.0));
        // `direct` is the light of the lamp itself if nothing blocks it, times 3, because `light` below is the
        // sum of three channels.
        vec3 to_lamp = to - 2.0 * (dot(mirror_normal, to) + (distant ? 0.0 : height)) * mirror_normal;
        float lamp_away = max(length(to_lamp), SBL_DIVISOR_LEAST);
        float direct = 3.0 * sbl_mirrored_power(i) * max(dot(normal, to_lamp) / lamp_away, 0.1);
        brightest = max(brightest, direct / (distant ? 1.0 : max(lamp_away * lamp_away, radius * radius)));
        vec3 reflected = sbl_fresnel(sbl_mirrored_reflectance(i), mirror_cosine);
        float light = covered * (reflected.r + reflected.g + reflected.b) * sbl_mirrored_power(i);
        light *= max(cosine, 0.1 * lamp);
        sbl_mirrored_add(vec4(to_image, width2), light / (distant ? 1.0 : max(away * away, radius * radius)));
    }
    float sum = 0.0;
    for (int k = 0; k < SBL_MIRRORED; k++) sum += mirrored_chance[k];
    for (int k = 0; k < SBL_MIRRORED; k++) mirrored_chance[k] /= max(sum, SBL_DIVISOR_LEAST);
    most *= min(SBL_MIRRORED_FRACTION * sum / max(brightest, SBL_DIVISOR_LEAST), 1.0);
    mirrored_rays = sum > SBL_DIVISOR_LEAST ? SBL_MIRRORED_RAYS * most : 0.0;
}

// Maps a uniform point u in the unit square to a direction near one of the mirrored lamps. tan^2 of the angle
// between the direction and the lamp has the distribution of GGX.
vec3 sbl_mirrored_sample(vec2 u) {
    vec4 highlight = mirrored_direction[0];
    float first = 0.0, chance = mirrored_chance[0], sum = mirrored_chance[0];
    for (int k = 1; k < SBL_MIRRORED; k++) {
        bool taken = u.x >= sum && mirrored_chance[k] > 0.0;
        highlight = taken ? mirrored_direction[k] : highlight;
        first = taken ? sum : first;
        chance = taken ? mirrored_chance[k] : chance;
        sum += mirrored_chance[k];
    }
    float x = clamp((u.x - first) / chance, 0.0, 0.999999), angle = 2.0 * SBL_PI * u.y;
    float tangent = sqrt(highlight.w * x / (1.0 - x));
    return normalize(sbl_frame(highlight.xyz) * vec3(tangent * cos(angle), tangent * sin(angle), 1.0));
}

// Returns the pdf, per solid angle, of the directions that sbl_mirrored_sample returns.
float sbl_mirrored_density(vec3 direction) {
    float density = 0.0;
    for (int k = 0; k < SBL_MIRRORED; k++) {
        float width2 = mirrored_direction[k].w, z = dot(direction, mirrored_direction[k].xyz);
        // A cross product replaces 1 - z^2, which is mostly rounding error in the middle of narrow highlights.
        vec3 cross_product = cross(direction, mirrored_direction[k].xyz);
        float t = z * z * width2 + dot(cross_product, cross_product);
        density += z > 0.0 ? mirrored_chance[k] * width2 * z / (SBL_PI * t * t) : 0.0;
    }
    return density;
}
#endif
