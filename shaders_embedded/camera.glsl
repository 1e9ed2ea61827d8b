// Returns rays through the camera's pixels, in world space. Origin and direction are affine functions of the
// pixel's position in the whole picture: _0 is the value at 0 0, _x and _y are the changes from pixel to pixel. A
// window therefore shows the same surface points as the whole picture, to the bit.
uniform vec2 first_pixel;  // position in the whole picture of the pixel at gl_FragCoord 0 0
uniform vec3 origin_0, origin_x, origin_y;
uniform vec3 direction_0, direction_x, direction_y;

vec3 sbl_camera_ray(vec3 at_0, vec3 at_x, vec3 at_y) {
    vec2 at = gl_FragCoord.xy + first_pixel;
    return at_0 + at.x * at_x + at.y * at_y;
}
vec3 sbl_camera_origin() { return sbl_camera_ray(origin_0, origin_x, origin_y); }
vec3 sbl_camera_direction() { return sbl_camera_ray(direction_0, direction_x, direction_y); }
