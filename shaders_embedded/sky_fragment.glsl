in vec3 direction;
uniform vec3 sky;                            // constant radiance of the sky
uniform float radiance_scale;
layout(location = 0) out vec4 out_radiance;  // a = 0: no surface, see sensor_fragment.glsl

void main() { out_radiance = vec4(radiance_scale * (sky + sbl_sky(direction)), 0); }
