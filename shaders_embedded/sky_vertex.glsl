// Draws the environment's picture as the background of the views of many sensors. Each instance covers the
// rectangle of one view. sensor_vertex.glsl explains the attributes.
layout(location = 5) in vec4 view_right;
layout(location = 6) in vec4 view_up;
layout(location = 7) in vec4 view_forward;
layout(location = 8) in vec2 view_offset;
out vec3 direction;

void main() {
    float x = gl_VertexID % 2 == 0 ? -1.0 : 1.0, y = gl_VertexID < 2 ? view_forward.w : 1.0;
    direction = view_forward.xyz + x / dot(view_right.xyz, view_right.xyz) * view_right.xyz +
                y / dot(view_up.xyz, view_up.xyz) * view_up.xyz;
    gl_Position = vec4(x * view_right.w + view_offset.x, y * view_up.w + view_offset.y, 0, 1);
}
