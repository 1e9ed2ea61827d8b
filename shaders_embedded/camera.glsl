// Returns rays through the camera's pixels, in world space. Origin and direction are affine functions of the
// pixel's position: _0 is the value at gl_FragCoord 0 0, _x and _y are the changes from pixel to pixel.
uniform vec3 origin_0, origin_x, origin_y;
uniform vec3 direction_0, direction_x, direction_y;

vec3 sbl_camera_origin() { return origin_0 + gl_FragCoord.x * origin_x + gl_FragCoord.y * origin_y; }
vec3 sbl_camera_direction() { return direction_0 + gl_FragCoord.x * direction_x + gl_FragCoord.y * direction_y; }
