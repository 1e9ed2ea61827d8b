// The store of bounced light (see >>store in sbl.h): R on surfaces, cell by cell.
#ifdef SBL_BOUNCED
// The table begins with a word a triangle of the scene; then the hash table of cells: check and reference; 0 0:
// nothing.
uniform int first_cell;   // texel that cells start at, two a texel
uniform int cell_mask;    // their slots - 1
uniform vec3 cell_origin;
uniform float per_cell;   // 1 / length of a cell of level 0

const float SBL_NEAR_SHARE = 0.5;  // see SBL__NEAR_SHARE

uint sbl_hash_step(uint hash, uint x) {
    hash = (hash ^ x) * 0x9e3779b1u;
    return hash ^ hash >> 15;
}

// R at a point of triangle number `number` of the scene, on its back side or its front, seen from so far away.
vec3 sbl_stored(int number, bool back, vec3 position, float distance) {
    uint patch_word = sbl_fetch(sbl_store, number >> 2)[number & 3] ^ (back ? SBL_PATCH_BACK : 0u);
    float per = per_cell / float(1u << (patch_word >> SBL_PATCH_LEVEL_SHIFT & SBL_PATCH_LEVEL));
    uvec3 at = uvec3(clamp((position - cell_origin) * per, vec3(0), vec3(2e9)));
    if ((patch_word & SBL_PATCH_FLAT) != 0u) {
        uint axis = patch_word >> SBL_PATCH_AXIS_SHIFT & 3u;
        at *= uvec3(axis != 0u, axis != 1u, axis != 2u);
    }
    if (distance * per < SBL_NEAR_SHARE) patch_word |= SBL_PATCH_NEAR;
    uint reference = 0u;
    for (int tries = 0; tries < 2 && reference == 0u; tries++) {  // or as seen from elsewhere
        uint hash = sbl_hash_step(sbl_hash_step(sbl_hash_step(sbl_hash_step(0u, patch_word), at.x), at.y), at.z);
        uint check = sbl_hash_step(sbl_hash_step(sbl_hash_step(hash, at.z), at.y), at.x) | 1u;
        for (int i = 0; i < SBL_PROBES; i++) {
            int place = int(hash + uint(i)) & cell_mask;
            uvec4 two = sbl_fetch(sbl_store, first_cell + (place >> 1));
            uvec2 slot = (place & 1) == 0 ? two.xy : two.zw;
            if (slot.x == check) reference = slot.y;
            if (slot.x == check || slot.x == 0u) break;
        }
        for (int i = 0; i < SBL_CELL_DEPTH && reference >= SBL_CELL_SPLIT; i++) {
            int split = int(reference & ~SBL_CELL_SPLIT);
            uvec2 sides = sbl_split_sides(split);
            reference = dot(sbl_split_normal(split), position) > sbl_split_distance(split) ? sides.y : sides.x;
        }
        patch_word ^= SBL_PATCH_NEAR;
    }
    return reference == 0u ? vec3(0) : sbl_leaf_light(int(reference) - 1);
}
#endif
