// Light from emitting triangles. What each gives where nothing stands between is known in closed form; rays only measure which share of it arrives
// (the ratio estimator: Heitz, Hill and McGuire 2018, "Combining analytic direct illumination and stochastic shadows").
// One invocation is one sensor, or a part of its rays where they are many: neighbours trace neighbouring rays, and each stops as soon as it knows enough.
uniform usamplerBuffer sbl_points;    // a sensor, three texels: position; normal; first of its directions, of its lamp points, two hashes for these
uniform usamplerBuffer sbl_sequence;  // see trace.glsl
uniform usamplerBuffer sbl_lamps;     // emitting triangles, as sbl_triangles counts
uniform int lamp_count, rays;         // at most SBL_LAMPS; at most so many rays a sensor
uniform float unit;                   // radiance that calculations are in: the scene's highest, so that none overflows
SBL_OUT(0, out_light);                // R, each part's own; the variance of its channels' mean

const float PI = 3.14159265;

struct sbl_Lamp { vec3 corner, side_1, side_2, emission; int triangle, number; };

// As seen from p: black where only its dark side shows.
sbl_Lamp sbl_lamp(int i, vec3 p) {
    int t = int(texelFetch(sbl_lamps, i).x);
    uvec4 a = sbl_fetch(sbl_triangles, 3 * t), b = sbl_fetch(sbl_triangles, 3 * t + 1), c = sbl_fetch(sbl_triangles, 3 * t + 2), light = sbl_object(a.w, 1);
    sbl_Lamp l = sbl_Lamp(uintBitsToFloat(a.xyz), uintBitsToFloat(b.xyz) - uintBitsToFloat(a.xyz), uintBitsToFloat(c.xyz) - uintBitsToFloat(a.xyz),
                          uintBitsToFloat(light.rgb) / unit, t, int(b.w));
    if ((light.w & SBL_ONE_SIDED_EMISSION) != 0u && dot(cross(l.side_1, l.side_2), p - l.corner) < 0.0) l.emission = vec3(0);
    return l;
}

// An edge's part of Lambert's sum: the angle it spans, times the cosine of its plane's normal to z.
float sbl_edge(vec3 p, vec3 q) {
    vec3 normal = cross(p, q);
    float size = length(normal);
    return size > 0.0 ? atan(size, dot(p, q)) * normal.z / size : 0.0;
}

// Share of a hemisphere around z that a triangle fills, weighted by the cosine: Lambert 1760. Corners relative to the sensor, in its frame.
float sbl_form_factor(vec3 a, vec3 b, vec3 c) {
    vec3 middle = (a + b + c) / 3.0, normal = cross(b - a, c - a);
    float distance2 = dot(middle, middle), size2 = max(dot(b - a, b - a), max(dot(c - a, c - a), dot(c - b, c - b)));
    if (min(a.z, min(b.z, c.z)) > 0.0 && distance2 > 1e5 * size2)  // too small for the sum's rounding, small enough for a point
        return 0.5 * abs(dot(normal, middle)) * middle.z / (PI * distance2 * distance2);
    vec3 corners[3] = vec3[3](a, b, c), entry = vec3(0), leave = vec3(0);
    float sum = 0.0;
    bool cut = false;
    for (int k = 0; k < 3; k++) {  // what is below the horizon does not count
        vec3 p = corners[k], q = corners[k == 2 ? 0 : k + 1];
        if (max(p.z, q.z) <= 0.0) continue;
        if (min(p.z, q.z) < 0.0) {
            vec3 x = vec3(mix(p.xy, q.xy, p.z / (p.z - q.z)), 0);
            cut = true;
            if (p.z < 0.0) entry = p = x;
            else leave = q = x;
        }
        sum += sbl_edge(p, q);
    }
    if (cut) sum += sbl_edge(leave, entry);
    return abs(sum) / (2.0 * PI);
}

// A direction to the spherical triangle of unit vectors a, b, c, evenly distributed: Arvo 1995, "Stratified Sampling of Spherical Triangles".
// w: its solid angle; 0 where it is too small for that.
vec4 sbl_spherical(vec3 a, vec3 b, vec3 c, vec2 u) {
    vec3 ab = cross(a, b), bc = cross(b, c), ca = cross(c, a);
    float alpha = atan(length(cross(ab, ca)), -dot(ab, ca)), beta = atan(length(cross(bc, ab)), -dot(bc, ab)), gamma = atan(length(cross(ca, bc)), -dot(ca, bc));
    float solid_angle = alpha + beta + gamma - PI;
    if (!(solid_angle > 0.01)) return vec4(0);
    float s = sin(u.x * solid_angle - alpha), t = cos(u.x * solid_angle - alpha), sin_alpha = sin(alpha), cos_alpha = cos(alpha);
    float p = t - cos_alpha, v = s + sin_alpha * dot(a, b);
    float q = clamp(((v * t - p * s) * cos_alpha - v) / ((v * s + p * t) * sin_alpha), -1.0, 1.0);
    vec3 cut = q * a + sqrt(1.0 - q * q) * normalize(c - dot(c, a) * a);
    float z = 1.0 - u.y * (1.0 - dot(cut, b));
    return vec4(z * b + sqrt(max(1.0 - z * z, 0.0)) * normalize(cut - dot(cut, b) * b), solid_angle);
}

void main() {
    ivec2 at = sbl_texel_of_invocation();
    int parts = blocks.y, part = at.y % parts, sensor = at.y / parts * columns + at.x - first_slot;
    if (sensor < 0 || sensor >= count) sbl_leave;
    uvec4 words = texelFetch(sbl_points, 3 * sensor + 2);
    vec3 position = uintBitsToFloat(texelFetch(sbl_points, 3 * sensor).xyz), n = uintBitsToFloat(texelFetch(sbl_points, 3 * sensor + 1).xyz);
    mat3 frame = transpose(sbl_frame(n));

    vec3 all = vec3(0);
    float strengths[SBL_LAMPS], total = 0.0;  // summed up, in proportion to what each gives here
    for (int i = 0; i < lamp_count; i++) {
        sbl_Lamp l = sbl_lamp(i, position);
        vec3 corner = frame * (l.corner - position);
        vec3 light = sbl_form_factor(corner, corner + frame * l.side_1, corner + frame * l.side_2) * l.emission;
        all += light;
        total += light.r + light.g + light.b;
        strengths[i] = total;
    }

    vec3 open = vec3(0), seen = vec3(0);  // what the samples give without and with what stands between
    float samples = 0.0, lit = 0.0;
    int step = clamp(rays / 32, 1, 4);  // the first quarter, or half of few, tells whether there is more to know: what it overlooks is less than a sample's share
    bool undecided = total > 0.0;
    for (int pass = 0; pass < step && undecided; pass++) {
        for (int k = part + pass * parts; k < rays; k += step * parts) {
            uvec2 fraction = texelFetch(sbl_sequence, int(words.y) + k).xy ^ words.zw;
            vec2 u = (vec2(fraction >> 8) + 0.5) / 16777216.0;

            // a lamp, in proportion to its strength
            float wanted = u.x * total, before = 0.0;
            int low = 0, high = lamp_count - 1;
            while (low < high) {
                int middle = (low + high) / 2;
                if (strengths[middle] < wanted) { low = middle + 1; before = strengths[middle]; }
                else high = middle;
            }
            u.x = clamp((wanted - before) / (strengths[low] - before), 0.0, 1.0);

            // a point on it: by solid angle where it is large, else by area (Heitz 2019, "A Low-Distortion Map Between Triangle and Square")
            sbl_Lamp l = sbl_lamp(low, position);
            vec3 corner = l.corner - position, normal = cross(l.side_1, l.side_2);
            vec4 ray = sbl_spherical(normalize(corner), normalize(corner + l.side_1), normalize(corner + l.side_2), u);
            u = u.y > u.x ? vec2(0.5 * u.x, u.y - 0.5 * u.x) : vec2(u.x - 0.5 * u.y, 0.5 * u.y);
            vec3 to = corner + u.x * l.side_1 + u.y * l.side_2;
            if (ray.w > 0.0) {
                to = ray.xyz * dot(corner, normal) / dot(ray.xyz, normal);
                u = vec2(dot(cross(to - corner, l.side_2), normal), dot(cross(l.side_1, to - corner), normal)) / dot(normal, normal);
            }
            float far = length(to);
            vec3 direction = to / far;
            float weight = ray.w > 0.0 ? 2.0 * ray.w : abs(dot(normal, direction)) / (far * far);
            vec3 light = l.emission * (max(dot(n, direction), 0.0) * weight / (strengths[low] - before));
            if (!(light.r + light.g + light.b > 0.0)) continue;
            open += light;
            samples += 1.0;
            sbl_Hit hit = sbl_trace(position, direction, far * 0.99999);
            if (hit.triangle >= 0 && hit.number != l.number) continue;
#ifdef SBL_TEXTURED
            sbl_Attributes at = sbl_attributes_at(l.triangle, u.x, u.y);
            light *= sbl_texture(sbl_object(sbl_fetch(sbl_triangles, 3 * l.triangle).w, 3), at.uv).rgb;
#endif
            seen += light;
            lit += 1.0;
        }
        undecided = seen != vec3(0) && seen != open;  // all is open, or nothing: the first samples tell
    }
    vec3 share = vec3(open.r > 0.0 ? seen.r / open.r : 0.0, open.g > 0.0 ? seen.g / open.g : 0.0, open.b > 0.0 ? seen.b / open.b : 0.0);
    float mean = dot(all, vec3(1.0 / 3.0)), lit_share = samples > 0.0 ? lit / samples : 0.0;
    // stratified points have far less variance than independent ones: a tenth is what edges across a lamp leave
    sbl_write(out_light, vec4(all * share * unit, samples > 0.0 ? 0.1 * mean * mean * lit_share * (1.0 - lit_share) / samples * unit * unit : 0.0));
}
