uniform vec3 origin_0, origin_x, origin_y;           // a pixel's ray, affine in its position
uniform vec3 direction_0, direction_x, direction_y;
uniform vec2 depth_from_w;                           // depth = x * gl_FragCoord.w + y, where the driver has no clip control
uniform float facet_limit;                           // shading normals count from triangles of this least height on, in pixels; fully from twice that on
layout(location = 0) out vec4 out_position;
layout(location = 1) out vec4 out_normal;
layout(location = 2) out vec4 out_geometric_normal;
layout(location = 3) out vec4 out_albedo;
layout(location = 4) out vec4 out_emission;
layout(location = 5) out uint out_id;

void main() {
    vec2 at = gl_FragCoord.xy;
    vec3 origin = origin_0 + at.x * origin_x + at.y * origin_y, direction = direction_0 + at.x * direction_x + at.y * direction_y;
    sbl_Surface s = sbl_surface(gl_PrimitiveID, origin, direction);
    // Shading normals are there to hide facets; facets that are too small to be seen show the light that the true surface gets.
    float pixel = length(origin_y + distance(s.position, origin) / length(direction) * direction_y);
    if (facet_limit > 0.0) s.normal = normalize(mix(s.geometric_normal, s.normal, clamp(s.facet / (facet_limit * pixel) - 1.0, 0.0, 1.0)));
    if (s.albedo.a == 0.0) discard;
    out_position = vec4(s.position, s.reach);
    out_normal = vec4(s.normal, 0);
    out_geometric_normal = vec4(s.geometric_normal, 0);
    out_albedo = vec4(s.albedo.rgb, 1);
    out_emission = vec4(s.emission, 0);
    out_id = s.id;
#ifdef SBL_WRITE_DEPTH
    gl_FragDepth = depth_from_w.x > 0.0 ? depth_from_w.x * gl_FragCoord.w : 2.0 * gl_FragCoord.z - 1.0;
#endif
}
