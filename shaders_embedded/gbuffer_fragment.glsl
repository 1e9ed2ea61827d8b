uniform vec3 origin_0, origin_x, origin_y;           // a pixel's ray, affine in its position
uniform vec3 direction_0, direction_x, direction_y;
uniform vec2 depth_from_w;                           // depth = x * gl_FragCoord.w + y, where the driver has no clip control
layout(location = 0) out vec4 out_position;
layout(location = 1) out vec4 out_normal;
layout(location = 2) out vec4 out_geometric_normal;
layout(location = 3) out vec4 out_albedo;
layout(location = 4) out vec4 out_emission;
layout(location = 5) out uint out_id;

void main() {
    vec2 at = gl_FragCoord.xy;
    sbl_Surface s = sbl_surface(gl_PrimitiveID, origin_0 + at.x * origin_x + at.y * origin_y, direction_0 + at.x * direction_x + at.y * direction_y);
    if (s.albedo.a == 0.0) discard;
    out_position = vec4(s.position, 0);
    out_normal = vec4(s.normal, 0);
    out_geometric_normal = vec4(s.geometric_normal, 0);
    out_albedo = vec4(s.albedo.rgb, 1);
    out_emission = vec4(s.emission, 0);
    out_id = s.id;
#ifdef SBL_WRITE_DEPTH
    gl_FragDepth = depth_from_w.x > 0.0 ? depth_from_w.x * gl_FragCoord.w : 2.0 * gl_FragCoord.z - 1.0;
#endif
}
