// The specular lobe of glTF 2.0's material model: GGX with height-correlated Smith shadowing (Heitz 2014) and
// Schlick's Fresnel term (1994). reflectance: fraction of light reflected at normal incidence, per colour.
// alpha: the squared roughness
#ifdef SBL_SPECULAR
const float SBL_DIFFUSE_LOST = 0.003685;  // cosine-weighted mean of sbl_diffuse_lost over the hemisphere
// Cosine-weighted means of E and b (see sbl__lobe_albedos in sbl.h) over the hemisphere, one per row of the table
const float SBL_LOBE_MEANS_E[16] = float[16](1.0, 0.9992, 0.9961, 0.9889, 0.9756, 0.9548, 0.9254, 0.8869, 0.8397,
                                             0.7849, 0.7241, 0.6597, 0.5938, 0.5289, 0.4669, 0.4091);
const float SBL_LOBE_MEANS_B[16] = float[16](0.0476, 0.0468, 0.0444, 0.0404, 0.0351, 0.0294, 0.024, 0.0191, 0.0151,
                                             0.0118, 0.0092, 0.0071, 0.0056, 0.0044, 0.0035, 0.0028);

// Returns the fraction of diffuse light that the Fresnel term removes, for a viewer at this cosine: the mean of (1
// - V.H)^5 over a Lambertian lobe, as a polynomial (error 7e-5).
float sbl_diffuse_lost(float cosine) {
    float u = 1.0 - cosine;
    return 0.00001 + u * (0.00424 + u * (-0.0018 + u * 0.02563));
}

// Returns the position of a row or a column in the tables of lobes. fraction: 0 to 1 from the first to the last
float sbl_lobe_step(float fraction) { return float(SBL_LOBE_ROWS - 1) * clamp(fraction, 0.0, 1.0); }

float sbl_lobe_row(float roughness) {
    return sbl_lobe_step((roughness - SBL_LOBE_FIRST) / (1.0 - SBL_LOBE_FIRST));
}

vec2 sbl_lobe_entry(int row, int column) {
    uint entry = sbl_lobe_table[SBL_LOBE_ROWS * row + column];
    return vec2(entry & 65535u, entry >> 16) / SBL_LOBE_UNIT;
}

// Returns the directional albedo of the lobe at this cosine, interpolated from sbl__lobe_albedos.
vec3 sbl_specular_albedo(vec3 reflectance, float roughness, float cosine) {
    float alpha = roughness * roughness, u = 1.0 - cosine;
    float x = sbl_lobe_step(cosine * (1.0 + alpha) / (cosine + alpha)), y = sbl_lobe_row(roughness);
    int column = min(int(x), SBL_LOBE_ROWS - 2), row = min(int(y), SBL_LOBE_ROWS - 2);
    vec2 upper = mix(sbl_lobe_entry(row, column), sbl_lobe_entry(row, column + 1), x - float(column));
    vec2 lower = mix(sbl_lobe_entry(row + 1, column), sbl_lobe_entry(row + 1, column + 1), x - float(column));
    vec2 entry = mix(upper, lower, y - float(row)) * vec2(1, u * u * u * u * u);
    return reflectance * (entry.x - entry.y) + entry.y;
}

// Returns the albedo of a surface: the cosine-weighted mean over the hemisphere. opacity: coverage of the surface,
// 0 to 1
vec3 sbl_albedo_mean(vec3 diffuse, vec3 reflectance, float roughness, float opacity) {
    float y = sbl_lobe_row(roughness);
    int row = min(int(y), SBL_LOBE_ROWS - 2);
    float e = mix(SBL_LOBE_MEANS_E[row], SBL_LOBE_MEANS_E[row + 1], y - float(row));
    float b = mix(SBL_LOBE_MEANS_B[row], SBL_LOBE_MEANS_B[row + 1], y - float(row));
    return (1.0 - SBL_DIFFUSE_LOST) * diffuse + opacity * (reflectance * (e - b) + b);
}

// A specular lobe. Vectors without "direction" in their name are in the frame of the lobe.
struct sbl_Lobe {
    mat3 frame;        // columns x: the direction to the viewer, projected onto the surface; z: the normal
    vec3 view;         // direction to the viewer
    vec3 reflectance;
    float alpha;       // 0: a perfect mirror
};

// view_direction: to the viewer
sbl_Lobe sbl_lobe_of(vec3 normal, vec3 view_direction, vec3 reflectance, float roughness) {
    vec3 tangent = view_direction - dot(view_direction, normal) * normal;
    float size = length(tangent);
    float alpha = roughness < SBL_MIRROR ? 0.0 : roughness * roughness;
    sbl_Lobe l = sbl_Lobe(sbl_frame(normal), vec3(0), reflectance, alpha);
    if (size > 1e-4) l.frame = mat3(tangent / size, cross(normal, tangent / size), normal);
    l.view = view_direction * l.frame;
    l.view = normalize(vec3(l.view.xy, max(l.view.z, 1e-3)));
    return l;
}

// Returns Smith's Lambda for a unit vector.
float sbl_lambda(float alpha, vec3 w) {
    vec2 slope = alpha * w.xy / max(abs(w.z), 1e-6);
    return 0.5 * sqrt(1.0 + dot(slope, slope)) - 0.5;
}

vec3 sbl_fresnel(vec3 reflectance, float cosine) {
    float x = 1.0 - clamp(cosine, 0.0, 1.0), x2 = x * x;
    return reflectance + (1.0 - reflectance) * (x2 * x2 * x);
}

// Samples a direction by mirroring the view at a visible normal (Dupuy and Benyoub 2023, "Sampling Visible GGX
// Normals with Spherical Caps"). u: uniform point in the unit square. weight: f * cosine / pdf
vec3 sbl_lobe_sample(sbl_Lobe l, vec2 u, out vec3 weight) {
    vec3 v = normalize(vec3(l.alpha * l.view.xy, l.view.z));
    float angle = 2.0 * SBL_PI * u.y, z = (1.0 - u.x) * (1.0 + v.z) - v.z, r = sqrt(clamp(1.0 - z * z, 0.0, 1.0));
    vec3 h = vec3(r * cos(angle), r * sin(angle), z) + v;
    h = normalize(vec3(l.alpha * h.xy, max(h.z, 1e-6)));
    float cosine = dot(l.view, h);
    vec3 w = 2.0 * cosine * h - l.view;
    float from_view = sbl_lambda(l.alpha, l.view);
    weight = sbl_fresnel(l.reflectance, cosine) * ((1.0 + from_view) / (1.0 + from_view + sbl_lambda(l.alpha, w)));
    if (w.z <= 0.0) weight = vec3(0);
    return l.frame * w;
}

// Returns the GGX distribution of normals at the half vector h of w and the view.
float sbl_lobe_ndf(sbl_Lobe l, vec3 w, out vec3 h) {
    float a2 = l.alpha * l.alpha;
    h = (w + l.view) / max(length(w + l.view), 1e-30);
    float d = dot(h.xy, h.xy) + a2 * h.z * h.z;  // 1 + (a2 - 1) h.z^2 without cancellation near h.z = 1
    return a2 / max(SBL_PI * d * d, 1e-37);
}

// Returns the factor of the lobe for light from a direction, relative to the factor of R: pi times the lobe's part
// of f (see ON REFLECTIONS in sbl.h).
vec3 sbl_lobe_factor(sbl_Lobe l, vec3 direction) {
    vec3 w = direction * l.frame, h;
    if (w.z <= 0.0 || l.alpha <= 0.0) return vec3(0);
    float ndf = sbl_lobe_ndf(l, w, h);
    float shadowing = 1.0 / (1.0 + sbl_lambda(l.alpha, l.view) + sbl_lambda(l.alpha, w));
    return sbl_fresnel(l.reflectance, dot(l.view, h)) * (SBL_PI * ndf * shadowing / (4.0 * l.view.z * w.z));
}

// Returns the pdf, per solid angle, of a direction from sbl_lobe_sample.
float sbl_lobe_density(sbl_Lobe l, vec3 direction) {
    vec3 h;
    if (l.alpha <= 0.0) return SBL_UNBOUNDED;
    float ndf = sbl_lobe_ndf(l, direction * l.frame, h);
    return ndf / ((1.0 + sbl_lambda(l.alpha, l.view)) * 4.0 * l.view.z);
}

// Returns the pdf, per solid angle, of a point on an emitting triangle, if it were sampled by area on the whole
// mesh. Rays to lamps pick one triangle of the mesh at random; the pdf for this triangle alone would be too large.
// object: index of the mesh; side_1, side_2: two edges of the triangle; to_point: vector from the viewer to the
// point
float sbl_area_density(int object, vec3 side_1, vec3 side_2, vec3 to_point) {
    // The vectors are divided by `size` before they are multiplied, because products of short vectors would
    // underflow. The length of `normal` is twice the area of the triangle, divided by the square of `size`.
    float size = max(length(to_point), SBL_DIVISOR_LEAST);
    vec3 normal = cross(side_1 / size, side_2 / size);
    float area = clamp(sbl_object_area(object) / size / size, 1e-37, 1e37);
    float fraction = min(0.5 * length(normal) / area, 1.0);
    return max(2.0 * fraction / max(abs(dot(normal, to_point / size)), 1e-30), 1e-30);
}

const float SBL_GLOW_DENSITY = 10.0;  // pdf for sbl_lobe_mis on glows

// Returns the MIS weight of rays of the lobe for a lamp's light from a direction; rays to lamps have the rest. It
// is the balance heuristic (Veach 1997) with the pdf of the lobe and one that is close to that of rays to lamps.
float sbl_lobe_mis(float lobe_density, float lamp_density) { return lobe_density / (lobe_density + lamp_density); }

#endif

#ifdef SBL_LOBE
sbl_Lobe lobe;         // the lobe of the look that is measured
vec3 lobe_scale;       // 1 / albedo of the lobe: the look measures the mean radiance that the lobe reflects
bool lobe_rough;       // true: closed forms and rays towards lamps measure lamps; false: MIS, see sbl_lobe_mis

void sbl_lobe_begin(int look, vec3 normal) {
    float roughness = sbl_lobe_roughness(look);
    lobe = sbl_lobe_of(normal, sbl_lobe_view(look), sbl_lobe_reflectance(look), roughness);
    lobe_scale = 1.0 / sbl_lobe_albedo(look);
    lobe_rough = roughness >= SBL_LOBE_ROUGH;
}

// Returns the matrix from world space to the space where the look's lobe is a cosine lobe: a linearly transformed
// cosine (Heitz, Dupuy, Hill and Neubelt 2016, "Real-Time Polygonal-Light Shading with Linearly Transformed
// Cosines").
mat3 sbl_lobe_to_cosine(int look) {
    mat3 inverse = mat3(sbl_lobe_xx(look), 0, sbl_lobe_zx(look), 0, 1, 0, sbl_lobe_xz(look), 0, sbl_lobe_zz(look));
    return inverse * transpose(lobe.frame);
}
#endif
