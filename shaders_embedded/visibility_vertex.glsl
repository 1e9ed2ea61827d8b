// Finds the triangle that each pixel of the camera shows. Depth is reversed: 1 at the near end, 0 at the far end.
uniform vec3 eye;
uniform vec4 clip_x, clip_y, clip_z, clip_w;  // rows of the matrix from world to clip space, for positions
                                              // relative to the eye
flat out int triangle;

void main() {
    triangle = gl_VertexID / 3;
    int vertex = int(sbl_fetch(sbl_indices, gl_VertexID).x);
    vec4 p = vec4(sbl_vertex_position(vertex) - eye, 1);
    gl_Position = vec4(dot(clip_x, p), dot(clip_y, p), dot(clip_z, p), dot(clip_w, p));
    if ((sbl_object_flags(int(sbl_vertex_object(vertex))) & SBL_HIDDEN_FROM_CAMERA) != 0u)
        gl_Position = vec4(2, 2, 2, 1);
}
