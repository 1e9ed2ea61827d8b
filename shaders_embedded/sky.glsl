// The environment's picture, equirectangular: light from where nothing is hit, besides the constant sky (see
// sbl_environment).
uniform sampler2D sky_picture;
uniform vec3 sky_x, sky_up, sky_z;  // its axes in the world
uniform float sky_limit;            // radiance from which on it is left to lamps.glsl; 0: there is no picture

// Where a direction meets the picture, in its widths and heights.
vec2 sbl_sky_at(vec3 direction) {
    vec3 d = vec3(dot(direction, sky_x), dot(direction, sky_up), dot(direction, sky_z)) / length(direction);
    float around = d.x == 0.0 && d.z == 0.0 ? 0.0 : atan(d.z, d.x) / (2.0 * SBL_PI);
    return vec2(0.5 + around, acos(clamp(d.y, -1.0, 1.0)) / SBL_PI);
}

// The way back; z: the cosine to sky_up.
vec3 sbl_sky_direction(float across, float z) {
    float angle = 2.0 * SBL_PI * (across - 0.5), r = sqrt(max(1.0 - z * z, 0.0));
    return r * cos(angle) * sky_x + z * sky_up + r * sin(angle) * sky_z;
}

// What of a texel's light lamps.glsl samples.
float sbl_sky_excess(vec3 radiance) {
    return max(1.0 - sky_limit / max(max(radiance.r, radiance.g), max(radiance.b, SBL_SKY_LEAST)), 0.0);
}

// The rest of it.
vec3 sbl_sky(vec3 direction) {
    vec3 radiance = vec3(0);
    if (sky_limit > 0.0) {
        ivec2 size = textureSize(sky_picture, 0);
        radiance = texelFetch(sky_picture, min(ivec2(sbl_sky_at(direction) * vec2(size)), size - 1), 0).rgb;
        radiance *= 1.0 - sbl_sky_excess(radiance);
    }
    return radiance;
}
