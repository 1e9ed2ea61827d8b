in vec3 direction;
uniform float radiance_scale;
layout(location = 0) out vec4 out_radiance;  // a: 0, no surface; otherwise see sensor_fragment.glsl

void main() { out_radiance = vec4(radiance_scale * sbl_sky(direction, 0.0), 0); }
