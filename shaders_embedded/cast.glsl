// Finds the first hit of each ray. If the limit of a ray is negative, the ray leaves a surface with the normal
// `direction` in a random, cosine-distributed direction, and -limit is its maximum length. out_position: xyz:
// position of the hit, far away if the ray hits nothing; w: 1 + number % SBL_CAST_NUMBERS (number: index in the
// scene of the triangle), negative for its back; 0 if the ray hits nothing or the driver ended a loop early
SBL_OUT(0, out_position);
// rgb: albedo for bounced light; a: number / SBL_CAST_NUMBERS, or SBL_LOST if the driver ended a loop early
SBL_OUT(1, out_albedo);
#ifdef SBL_BOUNCED  // the scene has metal
// rgb: light of lamps and of the sky that a ray finds by way of metal; a: 1: the ray has hit metal
SBL_OUT(2, out_shine);
#ifdef SBL_GROUPS
// rgb: the part of out_shine.rgb that the segment after the metal finds; a: layer of this part + SBL_CAST_LAYERS *
// layer of the rest, which comes from a lamp
SBL_OUT(3, out_parts);
#endif
vec4 parts;
uniform int sky_layer;

// Continues a ray that has hit metal by one segment, as sensors do. Updates hit, origin, direction and
// throughput to this segment. Returns the light of lamps and of the sky.
vec3 sbl_go_on(inout sbl_Hit hit, sbl_Material material, inout vec3 origin, inout vec3 direction,
               inout vec3 throughput, uint hash) {
    sbl_Reflection next = sbl_reflect(hit, material, direction, hash);
    sbl_Hit between = sbl_trace(next.from, next.to_lamp, next.away, SBL_RAY_SHADOW);
    bool open = next.away > 0.0 && (between.triangle < 0 || between.number == next.number);
    vec3 light = open ? throughput * sbl_tint * next.light : vec3(0);
    origin = next.from;
    direction = next.direction;
    hit = sbl_trace(origin, direction, SBL_UNBOUNDED, SBL_RAY_PATH);
    throughput *= next.throughput * sbl_tint;
    parts.a = float(sky_layer + SBL_CAST_LAYERS * next.layer);
    if (hit.triangle < 0) {
        parts.rgb = throughput * sbl_sky(direction, sbl_lobe_mis(next.density, SBL_LAMP_DENSITY));
        return light + parts.rgb;
    }
    lamp_mis = sbl_lobe_mis(next.density, sbl_hit_density(hit, direction));
    int object = int(sbl_triangle_object(hit.triangle));
    parts.rgb = throughput * sbl_outgoing(object, hit.back, sbl_attributes_of(hit));
    parts.a = float(int(sbl_object_layer(object)) + SBL_CAST_LAYERS * next.layer);
    return light + parts.rgb;
}
#endif

void main() {
    ivec2 texel = sbl_texel_of_invocation();
    int ray = texel.y * columns + texel.x;
    if (ray >= count) sbl_leave;
    vec3 origin = sbl_cast_origin(ray), direction = sbl_cast_direction(ray), albedo = vec3(0);
    float limit = sbl_cast_limit(ray);
    uint fractions = sbl_cast_fractions(ray);
    vec2 u = (vec2(fractions & 65535u, fractions >> 16) + 0.5) / 65536.0;
    if (limit < 0.0) direction = sbl_by_cosine(sbl_frame(direction), u);
    sbl_Hit hit = sbl_trace(origin, direction, abs(limit), SBL_RAY_PATH);
    vec3 throughput = sbl_tint, position = origin + direction * hit.distance;
    float low = 0.0, high = 0.0;
#ifdef SBL_BOUNCED
    vec4 shine = vec4(0);
    parts = vec4(0);
    sbl_Material material;
    if (limit < 0.0 && hit.triangle >= 0) {
        material = sbl_material(int(sbl_triangle_object(hit.triangle)), sbl_attributes_of(hit));
        hit_shines = sbl_shines(material, material.reflectance);
    }
    for (int once = 0; once < (hit_shines ? 1 : 0); once++) {
        shine = vec4(sbl_go_on(hit, material, origin, direction, throughput, fractions * SBL_HASH_FACTOR), 1);
        // A ray that hits nothing already has the sky's light. Its out_position is near, so that none is added.
        position = origin + direction * (hit.triangle < 0 ? 0.0 : hit.distance);
    }
    sbl_write(out_shine, shine);
#ifdef SBL_GROUPS
    sbl_write(out_parts, parts);
#endif
#endif
    if (hit.triangle >= 0) {
        int object = int(sbl_triangle_object(hit.triangle));
        albedo = sbl_bounced(sbl_material(object, sbl_attributes_of(hit)), throughput);
        low = (float(hit.number % SBL_CAST_NUMBERS) + 1.0) * (hit.back ? -1.0 : 1.0);
        high = float(hit.number / SBL_CAST_NUMBERS);
    }
    if (sbl_cut_short()) { low = 0.0; high = SBL_LOST; }
    sbl_write(out_position, vec4(position, low));
    sbl_write(out_albedo, vec4(albedo, high));
}
