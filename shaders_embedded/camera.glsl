// Returns rays through the camera's pixels, in world space. Origin and direction are affine in the pixel's
// position.
uniform vec3 origin_0, origin_x, origin_y;
uniform vec3 direction_0, direction_x, direction_y;

vec3 sbl_camera_origin() { return origin_0 + gl_FragCoord.x * origin_x + gl_FragCoord.y * origin_y; }
vec3 sbl_camera_direction() { return direction_0 + gl_FragCoord.x * direction_x + gl_FragCoord.y * direction_y; }
