in vec3 direction;
uniform vec3 sky;  // constant
uniform float radiance_scale;
layout(location = 0) out vec4 out_radiance;  // as in sensor_fragment.glsl; nothing is hit

void main() { out_radiance = vec4(radiance_scale * (sky + sbl_sky(direction)), 0); }
