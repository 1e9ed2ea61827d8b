// The environment (see sbl_environment). The picture has an equirectangular projection.
uniform sampler2D sky_picture;
uniform vec3 sky;                   // constant radiance from all directions; the picture is added to it
uniform vec3 sky_x, sky_up, sky_z;  // axes of the picture in world space: unit vectors
uniform float sky_limit;            // radiance (largest component) above which a texel is also a lamp, which emits
                                    // the excess; 0: no picture
uniform float sky_excess;           // integral, over all directions, of the radiance above sky_limit

// Returns the position in the picture for a direction: 0 to 1 from left to right and from top to bottom.
vec2 sbl_sky_at(vec3 direction) {
    vec3 d = vec3(dot(direction, sky_x), dot(direction, sky_up), dot(direction, sky_z)) / length(direction);
    float azimuth = d.x == 0.0 && d.z == 0.0 ? 0.0 : atan(d.z, d.x) / (2.0 * SBL_PI);
    return vec2(0.5 + azimuth, acos(clamp(d.y, -1.0, 1.0)) / SBL_PI);
}

// Inverse of sbl_sky_at: returns the world direction for a position in the picture. u: 0 to 1 from left to
// right; z: cosine of the angle between the direction and sky_up
vec3 sbl_sky_direction(float u, float z) {
    float angle = 2.0 * SBL_PI * (u - 0.5), r = sqrt(max(1.0 - z * z, 0.0));
    return r * cos(angle) * sky_x + z * sky_up + r * sin(angle) * sky_z;
}

// Returns the fraction of a texel's radiance, 0 to 1, that exceeds the limit, so that lamps.glsl samples it.
float sbl_sky_excess(vec3 radiance) {
    return max(1.0 - sky_limit / max(max(radiance.r, radiance.g), max(radiance.b, SBL_SKY_LEAST)), 0.0);
}

// Returns the pdf, per solid angle, of the directions of a texel, if texels were sampled in proportion to their
// radiance above the limit. Rays to lamps sample them approximately so. radiance: that of the texel
float sbl_sky_density(vec3 radiance) {
    float excess = max(radiance.r, max(radiance.g, radiance.b)) - sky_limit;
    return max(excess / max(sky_excess, 1e-30), 1e-30);
}

// Returns the radiance of a ray that hits nothing. Rays to lamps find radiance above the limit, too; the result
// contains only a fraction of it, the MIS weight of the ray (see sbl_lobe_mis in lobe.glsl). lobe_density: pdf,
// per solid angle, with which a lobe chose the direction; 0: rays to lamps find all radiance above the limit
vec3 sbl_sky(vec3 direction, float lobe_density) {
    vec3 radiance = vec3(0);
    if (sky_limit > 0.0) {
        ivec2 size = textureSize(sky_picture, 0);
        radiance = texelFetch(sky_picture, min(ivec2(sbl_sky_at(direction) * vec2(size)), size - 1), 0).rgb;
        float mis = lobe_density / (lobe_density + sbl_sky_density(radiance));
        radiance *= 1.0 - (1.0 - mis) * sbl_sky_excess(radiance);
    }
    return sky + radiance;
}

// Returns the radiance of the environment picture in a direction, bilinearly filtered.
vec3 sbl_sky_smooth(vec3 direction) {
    vec3 radiance = vec3(0);
    ivec2 size = textureSize(sky_picture, 0);
    vec2 at = sbl_sky_at(direction) * vec2(size) - 0.5, corner = floor(at), f = at - corner;
    for (int i = 0; i < (sky_limit == 0.0 ? 0 : 4); i++) {
        ivec2 step = ivec2(i & 1, i >> 1), texel = ivec2(corner) + step;
        vec2 weight = mix(1.0 - f, f, vec2(step));
        texel = ivec2((texel.x + size.x) % size.x, clamp(texel.y, 0, size.y - 1));
        radiance += weight.x * weight.y * texelFetch(sky_picture, texel, 0).rgb;
    }
    return radiance;
}
