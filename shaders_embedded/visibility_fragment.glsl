flat in int triangle;
// For drivers without clip control. Above 0 (perspective): depth = depth_from_w * gl_FragCoord.w; 0
// (orthographic): depth = 2 * gl_FragCoord.z - 1
uniform float depth_from_w;
layout(location = 0) out uint out_triangle;  // 1 + index of the triangle in the scene; 0: none

void main() {
#ifdef SBL_CUTOUTS
    if (sbl_has_holes(int(sbl_vertex_object(sbl_corners(triangle).x))))
        if (sbl_surface(triangle, sbl_camera_origin(), sbl_camera_direction()).material.cut_out) discard;
#endif
    out_triangle = uint(triangle) + 1u;
#ifdef SBL_WRITE_DEPTH
    gl_FragDepth = depth_from_w > 0.0 ? depth_from_w * gl_FragCoord.w : 2.0 * gl_FragCoord.z - 1.0;
#endif
}
