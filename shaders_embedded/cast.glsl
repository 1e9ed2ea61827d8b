// Finds the first hit of each ray. If the limit of a ray is negative, the ray leaves a surface with the normal
// `direction` in a random, cosine-distributed direction, and -limit is its maximum length. out_position: xyz:
// position of the hit, far away if the ray hits nothing; w: 1 + number % SBL_CAST_NUMBERS (number: index of the
// triangle in the scene), negative for its back; 0 if the ray hits nothing or the driver ended a loop early
SBL_OUT(0, out_position);
// rgb: albedo of the hit for bounced light. If the ray hits nothing, rgb is the factor by which the sky's light is
// multiplied: the fraction that the panes on the way pass, divided by the probability that the ray passes them
// (see sbl_tint). a: number / SBL_CAST_NUMBERS, or SBL_LOST if the driver ended a loop early
SBL_OUT(1, out_albedo);
// SBL_POOLED: if it is defined, a workgroup casts SBL_CAST_POOL rays. Its invocations then share the rays that
// continue, see trace.glsl
#ifdef SBL_COMPUTE
#define sbl_write_ray(name, ray, value) imageStore(name, ivec2((ray) % columns, (ray) / columns), value)
#else
#define sbl_write_ray(name, ray, value) name = value
#endif
#ifdef SBL_BOUNCED  // the scene has metal
// rgb: light of lamps and of the sky that a ray finds after it has hit metal; a: 1: the ray has hit metal
SBL_OUT(2, out_metal_light);
#ifdef SBL_GROUPS
// out_metal_light.rgb is the sum of the light of a lamp and of the light that the last segment of the ray finds.
// rgb: the light that the last segment finds; a: layer of this light + SBL_CAST_LAYERS * layer of the lamp's light
SBL_OUT(3, out_last_light);
#endif
vec4 last_light;
uniform int sky_layer;

// Continues a ray that has hit metal by one segment, as sensors do. Updates hit, origin, direction and
// throughput to this segment. Returns the light of lamps and of the sky.
vec3 sbl_continue_ray(inout sbl_Hit hit, sbl_Material material, inout vec3 origin, inout vec3 direction,
               inout vec3 throughput, uint hash) {
    sbl_Reflection next = sbl_reflect(hit, material, direction, hash);
    sbl_Hit between = sbl_trace(next.from, next.to_lamp, next.away, SBL_RAY_SHADOW);
    bool open = next.away > 0.0 && (between.triangle < 0 || between.number == next.number);
    vec3 light = open ? throughput * sbl_tint * next.light : vec3(0);
    origin = next.from;
    direction = next.direction;
    hit = sbl_trace(origin, direction, SBL_UNBOUNDED, SBL_RAY_PATH);
    throughput *= next.throughput * sbl_tint;
    last_light.a = float(sky_layer + SBL_CAST_LAYERS * next.layer);
    if (hit.triangle < 0) {
        last_light.rgb = throughput * sbl_sky(direction, next.density);
        return light + last_light.rgb;
    }
    lamp_mis = sbl_lobe_mis(next.density, sbl_hit_density(hit, direction));
    int object = int(sbl_triangle_object(hit.triangle));
    last_light.rgb = throughput * sbl_outgoing(object, hit.back, sbl_attributes_of(hit));
    last_light.a = float(int(sbl_object_layer(object)) + SBL_CAST_LAYERS * next.layer);
    return light + last_light.rgb;
}
#endif

// Traces the first segment of a ray. Returns true if the ray continues from metal.
bool sbl_cast_ray(int ray, out sbl_Hit hit, out vec3 origin, out vec3 direction) {
    origin = sbl_cast_origin(ray);
    direction = sbl_cast_direction(ray);
    float limit = sbl_cast_limit(ray);
    uint fractions = sbl_cast_fractions(ray);
    vec2 u = (vec2(fractions & 65535u, fractions >> 16) + 0.5) / 65536.0;
    if (limit < 0.0) direction = sbl_by_cosine(sbl_frame(direction), u);
    hit = sbl_trace(origin, direction, abs(limit), SBL_RAY_PATH);
#ifdef SBL_BOUNCED
    sbl_Material material;
    hit_continues = false;
    if (limit < 0.0 && hit.triangle >= 0) {
        material = sbl_material(int(sbl_triangle_object(hit.triangle)), sbl_attributes_of(hit));
        hit_continues = sbl_is_strong(material, material.reflectance);
    }
    return hit_continues;
#else
    return false;
#endif
}

// Writes the last hit of a ray.
void sbl_cast_write(int ray, sbl_Hit hit, vec3 position, vec3 throughput) {
    vec3 albedo = min(throughput, vec3(1));
    float low = 0.0, high = 0.0;
    if (hit.triangle >= 0) {
        int object = int(sbl_triangle_object(hit.triangle));
        albedo = sbl_bounced(sbl_material(object, sbl_attributes_of(hit)), throughput);
        low = (float(hit.number % SBL_CAST_NUMBERS) + 1.0) * (hit.back ? -1.0 : 1.0);
        high = float(hit.number / SBL_CAST_NUMBERS);
    }
    if (sbl_cut_short()) { low = 0.0; high = SBL_LOST; }
    sbl_write_ray(out_position, ray, vec4(position, low));
    sbl_write_ray(out_albedo, ray, vec4(albedo, high));
}

#ifdef SBL_BOUNCED
// Writes the light that a ray has found after it hit metal.
void sbl_cast_write_metal_light(int ray, vec4 light) {
    sbl_write_ray(out_metal_light, ray, light);
#ifdef SBL_GROUPS
    sbl_write_ray(out_last_light, ray, last_light);
#endif
}

// Continues a ray that has hit metal, and writes the light that it finds.
void sbl_cast_continue(int ray, sbl_Hit hit, vec3 origin, vec3 direction, vec3 throughput) {
    sbl_Material material = sbl_material(int(sbl_triangle_object(hit.triangle)), sbl_attributes_of(hit));
    uint hash = sbl_cast_fractions(ray) * SBL_HASH_FACTOR;
    hit_continues = true;
    sbl_cast_write_metal_light(ray, vec4(sbl_continue_ray(hit, material, origin, direction, throughput, hash), 1));
    // A ray that hits nothing has got the sky's light above. Its out_position is its origin, not far away, so that
    // the sky's light is not added again.
    sbl_cast_write(ray, hit, origin + direction * (hit.triangle < 0 ? 0.0 : hit.distance), throughput);
}
#endif

#ifdef SBL_POOLED
shared int pool_count;                       // number of rays in the pool
shared vec4 pool_directions[SBL_CAST_POOL];  // xyz: direction of the segment that ends at the hit; w: sbl_Hit.b1
shared vec4 pool_tints[SBL_CAST_POOL];       // rgb: throughput; a: sbl_Hit.b2
shared ivec2 pool_hits[SBL_CAST_POOL];       // x: 2 * sbl_Hit.triangle + (1 for its back); y: index of the ray

void main() {
    int mine = int(gl_LocalInvocationIndex), first = int(gl_WorkGroupID.x) * SBL_CAST_POOL;
    if (mine == 0) pool_count = 0;
    memoryBarrierShared();
    barrier();
    for (int ray = first + mine; ray < min(first + SBL_CAST_POOL, count); ray += SBL_LOCKSTEP) {
        sbl_Hit hit;
        vec3 origin, direction;
        bool continues = sbl_cast_ray(ray, hit, origin, direction);
        if (continues) {
            int entry = atomicAdd(pool_count, 1);
            pool_directions[entry] = vec4(direction, hit.b1);
            pool_tints[entry] = vec4(sbl_tint, hit.b2);
            pool_hits[entry] = ivec2(2 * hit.triangle + (hit.back ? 1 : 0), ray);
        } else {
            sbl_cast_write(ray, hit, origin + direction * hit.distance, sbl_tint);
            sbl_cast_write_metal_light(ray, vec4(0));
        }
    }
    memoryBarrierShared();
    barrier();
    int filled = pool_count;
    for (int entry = mine; entry < filled; entry += SBL_LOCKSTEP) {
        int triangle = pool_hits[entry].x >> 1;
        sbl_Hit hit = sbl_Hit(0.0, triangle, int(sbl_triangle_number(triangle)), pool_directions[entry].w,
                              pool_tints[entry].w, (pool_hits[entry].x & 1) != 0);
        sbl_cast_continue(pool_hits[entry].y, hit, vec3(0), pool_directions[entry].xyz, pool_tints[entry].rgb);
    }
}
#else
void main() {
    ivec2 texel = sbl_texel_of_invocation();
    int ray = texel.y * columns + texel.x;
    if (ray >= count) sbl_leave;
    sbl_Hit hit;
    vec3 origin, direction;
    bool continues = sbl_cast_ray(ray, hit, origin, direction);
    sbl_cast_write(ray, hit, origin + direction * hit.distance, sbl_tint);
#ifdef SBL_BOUNCED
    last_light = vec4(0);
    sbl_cast_write_metal_light(ray, vec4(0));
    for (int once = 0; once < (continues ? 1 : 0); once++)
        sbl_cast_continue(ray, hit, origin, direction, sbl_tint);
#endif
}
#endif
