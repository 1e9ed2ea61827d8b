// The camera's view of the scene. Depth is reversed: 1 at the near end, 0 at infinity.
layout(location = 0) in vec3 position;
layout(location = 1) in uint object;
uniform vec3 eye;
uniform vec4 clip_x, clip_y, clip_z, clip_w;  // rows of world to clip, the world taken relative to the eye

void main() {
    vec4 p = vec4(position - eye, 1);
    gl_Position = vec4(dot(clip_x, p), dot(clip_y, p), dot(clip_z, p), dot(clip_w, p));
    if ((sbl_object(object, 1).w & SBL_HIDDEN_FROM_CAMERA) != 0u) gl_Position = vec4(2, 2, 2, 1);
}
