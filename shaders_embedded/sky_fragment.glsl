in vec3 direction;
uniform vec3 sky;                            // constant radiance of the sky
uniform float radiance_scale;
layout(location = 0) out vec4 out_radiance;  // a: distance as in sensor_fragment.glsl; 0: no surface

void main() { out_radiance = vec4(radiance_scale * (sky + sbl_sky(direction)), 0); }
