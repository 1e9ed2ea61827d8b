// View transforms: convert radiance to the colour that a screen shows, linear, 0 to 1.
uniform int tone;                    // sbl_tone
uniform float exposure;              // factor applied to radiance
const int SBL_TONE_NEUTRAL = 2, SBL_TONE_AGX = 3;
const float SBL_TONE_MOST = 1e8;     // larger values, including infinity, are lowered to this

// PBR Neutral (Khronos Group 2024): subtracts up to 0.04 from all channels, and fades colours above 0.8 to white.
const float SBL_NEUTRAL_TOE = 0.08, SBL_NEUTRAL_KNEE = 0.76, SBL_NEUTRAL_FADE = 0.15;

vec3 sbl_neutral(vec3 c) {
    float least = min(c.r, min(c.g, c.b)), headroom = 1.0 - SBL_NEUTRAL_KNEE;
    c -= least < SBL_NEUTRAL_TOE ? least - least * least / (2.0 * SBL_NEUTRAL_TOE) : 0.5 * SBL_NEUTRAL_TOE;
    float peak = max(c.r, max(c.g, c.b));
    if (peak <= SBL_NEUTRAL_KNEE) return c;
    float shown = 1.0 - headroom * headroom / (peak + headroom - SBL_NEUTRAL_KNEE);
    return mix(vec3(shown), c * (shown / peak), 1.0 / (SBL_NEUTRAL_FADE * (peak - shown) + 1.0));
}

// AgX (Sobotka 2022): mixes the primaries a little, so that bright colours fade to white as on film, then applies
// a sigmoid to the logarithm, from 10 stops below middle grey (0.18) to 6.5 stops above it. The columns of the
// matrices are the images of red, green and blue.
const mat3 SBL_AGX_MIX = mat3(0.842401, 0.042401, 0.042401, 0.078437, 0.878437, 0.078437,
                              0.079162, 0.079162, 0.879162);
const mat3 SBL_AGX_UNMIX = mat3(1.196999, -0.053001, -0.053001, -0.098046, 1.151954, -0.098046,
                                -0.098953, -0.098953, 1.151047);
const float SBL_AGX_GREY = 10.0 / 16.5;

// Returns 2 x / (1 + a x^power)^(1 / power); a is chosen so that the value at x = end is 0.5.
vec3 sbl_agx_half(vec3 x, float end, float power) {
    float a = (pow(4.0 * end, power) - 1.0) / pow(end, power);
    return 2.0 * x * pow(1.0 + a * pow(x, vec3(power)), vec3(-1.0 / power));
}

vec3 sbl_agx(vec3 c) {
    vec3 stops = log2(max(SBL_AGX_MIX * c, 1e-10) / 0.18);
    vec3 x = clamp(stops / 16.5 + SBL_AGX_GREY, 0.0, 1.0) - SBL_AGX_GREY;
    vec3 sigmoid = 0.5 + sbl_agx_half(max(x, 0.0), 1.0 - SBL_AGX_GREY, 3.25) -
                   sbl_agx_half(max(-x, 0.0), SBL_AGX_GREY, 3.0);
    return pow(max(SBL_AGX_UNMIX * sigmoid, 0.0), vec3(2.2));
}

vec3 sbl_shown(vec3 radiance) {
    vec3 c = min(max(radiance * exposure, 0.0), SBL_TONE_MOST);
    return clamp(tone == SBL_TONE_NEUTRAL ? sbl_neutral(c) : tone == SBL_TONE_AGX ? sbl_agx(c) : c, 0.0, 1.0);
}
