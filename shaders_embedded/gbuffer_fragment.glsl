// Computes the surface points that the camera's pixels, or the texels of a lightmap, show.
uniform usampler2D triangles;  // output of visibility_fragment.glsl; lightmaps: see SBL__ATLAS_WORDS
uniform float facet_limit;     // pixels; 0: not used. Triangles whose least height, seen face-on, is below it get
                               // the geometric normal, above twice it the shading normal, in between a mixture
layout(location = 0) out vec4 out_position;          // w: sbl_Surface.reach, see surface.glsl
layout(location = 1) out vec4 out_normal;
layout(location = 2) out vec4 out_geometric_normal;
layout(location = 3) out vec4 out_albedo;
layout(location = 4) out vec4 out_emission;
layout(location = 5) out uint out_id;
#ifdef SBL_SPECULAR
layout(location = 6) out vec4 out_specular;  // albedo of the specular lobe for this view; 0: none
layout(location = 7) out vec4 out_lobe;      // sbl_Material.reflectance; w: roughness, negative: no lobe
#endif
// In SBL_MODE_GI, w of normal, geometric normal and emission hold red, green and blue of the stored R. Where no
// sensor may stand, w of normal is -1 - red.

#ifdef SBL_BOUNCED
// Returns the mean of the stored R over 5 x 5 points in about one cell, without the points where R is 0. Used
// where no sensor may stand, because there no sensor smooths R. points: 25, or 0 if the result is not needed
vec3 sbl_stored_smooth(int number, sbl_Surface s, int points) {
    mat3 frame = sbl_frame(s.geometric_normal);
    float step = 0.25 / per_cell, weight = 0.0;
    vec3 sum = vec3(0);
    for (int i = 0; i < points; i++) {
        vec3 place = s.position + step * (frame * vec3(i % 5 - 2, i / 5 - 2, 0));
        vec3 light = sbl_stored(number, s.back, place, SBL_UNBOUNDED);
        sum += light;
        weight += max(light.r, max(light.g, light.b)) > 0.0 ? 1.0 : 0.0;
    }
    return sum / max(weight, 1.0);
}
#endif

void main() {
    uvec4 texel = texelFetch(triangles, ivec2(gl_FragCoord.xy), 0);
    uint triangle = texel.x;
    out_position = out_normal = out_geometric_normal = out_albedo = out_emission = vec4(0);
    out_id = 0u;
#ifdef SBL_SPECULAR
    out_specular = vec4(0);
    out_lobe = vec4(0, 0, 0, -1);
#endif
    if (triangle > 0u) {
#ifdef SBL_LIGHTMAP
        sbl_Surface s = sbl_surface_front(int(triangle) - 1, uintBitsToFloat(texel.y), uintBitsToFloat(texel.z));
        s.id = texel.w;
#else
        vec3 origin = sbl_camera_origin(), direction = sbl_camera_direction();
        sbl_Surface s = sbl_surface(int(triangle) - 1, origin, direction);
        // Width of a pixel at the surface, world units. Facets too small to be seen get their geometric normal.
        float pixel = length(origin_y + distance(s.position, origin) / length(direction) * direction_y);
        if (facet_limit > 0.0)
            s.normal = normalize(mix(s.geometric_normal, s.normal,
                                     clamp(s.facet / (facet_limit * pixel) - 1.0, 0.0, 1.0)));
#endif
        out_position = vec4(s.position, s.reach);
        out_normal = vec4(s.normal, 0);
        out_geometric_normal = vec4(s.geometric_normal, 0);
        out_albedo = vec4(s.material.albedo, 1);
        out_emission = vec4(s.emission, 0);
        out_id = s.id;
#if defined(SBL_SPECULAR) && !defined(SBL_LIGHTMAP)
        if (s.material.roughness >= 0.0) {
            float cosine = clamp(-dot(s.normal, normalize(direction)), 1e-3, 1.0);
            out_specular = vec4(sbl_specular_albedo(s.material.reflectance, s.material.roughness, cosine), 1);
            out_lobe = vec4(s.material.reflectance, s.material.roughness);
            out_albedo.rgb = s.material.diffuse * (1.0 - sbl_diffuse_lost(cosine));
        }
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
