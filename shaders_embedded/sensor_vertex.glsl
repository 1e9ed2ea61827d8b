// Draws the scene into the views of many sensors. Each instance is a view, clipped to its part of the view
// texture.
layout(location = 0) in vec3 position;
layout(location = 1) in uint object;
layout(location = 2) in vec2 vertex_uv;
layout(location = 3) in uvec2 vertex_color;
layout(location = 4) in vec3 view_eye;      // position of the sensor
layout(location = 5) in vec4 view_right;    // xyz: unit vector to the right / tan(fov / 2); w: scale of x in clip
                                            // space
layout(location = 6) in vec4 view_up;       // xyz: unit vector up / tan(fov / 2); w: scale of y in clip space
layout(location = 7) in vec4 view_forward;  // xyz: unit vector; w: lowest y: -1, or 0 if the view begins at the
                                            // horizon
layout(location = 8) in vec2 view_offset;   // normalised device coordinates of the view's forward axis
uniform float per_length;                   // 1 / extent of the scene
uniform float radiance_scale;
out vec3 clip;                              // x, y and w of gl_Position
flat out int fragment_object;               // only with SBL_TEXTURED or SBL_BOUNCED
flat out vec3 radiance_front, radiance_back;  // only without SBL_TEXTURED and SBL_BOUNCED
out vec2 fragment_uv;                       // only with SBL_TEXTURED, like fragment_color
out vec4 fragment_color;
out vec3 fragment_from_sensor;              // only with SBL_BOUNCED: vector from the sensor to the surface
out vec3 fragment_position;                 // only with SBL_BOUNCED: point on the surface in world space

void main() {
    int number = int(object);
#ifdef SBL_BOUNCED
    fragment_from_sensor = position - view_eye;
    fragment_position = position;
#endif
#ifdef SBL_TEXTURED
    fragment_uv = vertex_uv;
    fragment_color = sbl_unpack_color(vertex_color.x, vertex_color.y) / SBL_COLOR_MOST;
#endif
#if defined(SBL_TEXTURED) || defined(SBL_BOUNCED)
    fragment_object = number;
#else
    radiance_front = radiance_scale * sbl_outgoing(number, false, SBL_PLAIN);
    radiance_back = radiance_scale * sbl_outgoing(number, true, SBL_PLAIN);
#endif
    vec3 p = (position - view_eye) * per_length;
    float x = dot(view_right.xyz, p), y = dot(view_up.xyz, p), w = dot(view_forward.xyz, p);
    gl_Position = vec4(x * view_right.w + w * view_offset.x, y * view_up.w + w * view_offset.y, SBL_VIEW_DEPTH, w);
    clip = gl_Position.xyw;
    gl_ClipDistance[0] = w + x;
    gl_ClipDistance[1] = w - x;
    gl_ClipDistance[2] = y - w * view_forward.w;
    gl_ClipDistance[3] = w - y;
    if ((sbl_object_flags(number) & SBL_HIDDEN_FROM_SENSORS) != 0u) gl_ClipDistance[0] = -1.0;
}
