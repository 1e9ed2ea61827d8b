// Copies level 0 of a texture of the host. texelFetch applies the texture's sRGB decoding and swizzle.
uniform sampler2D source;
layout(location = 0) out vec4 out_color;

void main() { out_color = texelFetch(source, ivec2(gl_FragCoord.xy), 0); }
