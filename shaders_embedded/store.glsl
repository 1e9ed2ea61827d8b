// The store of bounced light (see >>store in sbl.h): R (irradiance / pi) on surfaces, in cells.
#ifdef SBL_BOUNCED
// The table sbl_store holds the patch words of all triangles, the hash table of cells, the cuts, and the leaves.
uniform int first_cell;    // texel at which the hash table begins; each texel holds two buckets (check, reference)
uniform int cell_mask;     // number of buckets in the hash table - 1
uniform vec3 cell_origin;  // origin of the grid of cells
uniform float per_cell;    // 1 / length of a cell of level 0
uniform int bright_cells;  // number of cells with bright leaves (see >>glow in sbl.h); 0: there are no glows

uint sbl_hash_step(uint hash, uint x) {
    hash = (hash ^ x) * SBL_HASH_FACTOR;
    return hash ^ hash >> SBL_HASH_SHIFT;
}

// Returns true if rays of this length read the cells for short rays.
bool sbl_is_short(float distance) { return distance * per_cell * float(SBL_SHORT_PART) < 1.0; }

const float SBL_GLOW_REACH = 6.0;  // lengths of a cell of level 0 at which sbl_glow_mis is 1/2

// Returns the MIS weight, for the light of a glow, of a segment of this length that leaves a diffuse surface. A
// ray to a glow has the rest (see sbl_reflect). Segments often hit glows that are close, because glows are about
// as large as cells, but a single ray to one of many close glows would be noisy.
float sbl_glow_mis(float distance) {
    float x = distance * per_cell / SBL_GLOW_REACH;
    return 1.0 / (1.0 + x * x);
}

// Returns 1 + the index of the leaf at a position on triangle `number` of the scene, or 0 if no leaf is there.
// back: the ray sees the back of the triangle. distance: length of the ray that sees the position
int sbl_leaf_at(int number, bool back, vec3 position, float distance) {
    uint patch_word = sbl_fetch(sbl_store, number >> 2)[number & 3] ^ (back ? SBL_PATCH_BACK : 0u);
    uvec3 at = uvec3(clamp((position - cell_origin) * per_cell, vec3(0), vec3(SBL_CELL_MOST)));
    if ((patch_word & SBL_PATCH_FLAT) != 0u) {
        uint axis = patch_word >> SBL_PATCH_AXIS_SHIFT & 3u;
        at *= uvec3(axis != 0u, axis != 1u, axis != 2u);
    }
    if (sbl_is_short(distance)) patch_word |= SBL_PATCH_SHORT;
    uint reference = 0u;
    // Each level has cells for short rays and cells for long rays. This loop first tries the kind that suits
    // `distance`.
    for (int tries = 0; tries < 2 * SBL_LEVELS && reference == 0u; tries++) {
        uint hash = sbl_hash_step(sbl_hash_step(sbl_hash_step(sbl_hash_step(0u, patch_word), at.x), at.y), at.z);
        uint check = sbl_hash_step(sbl_hash_step(sbl_hash_step(hash, at.z), at.y), at.x) | 1u;
        for (int i = 0; i < SBL_BUCKET_TRIES; i++) {
            int bucket = int(hash + uint(i)) & cell_mask;
            uvec4 two = sbl_fetch(sbl_store, first_cell + (bucket >> 1));
            uvec2 found = (bucket & 1) == 0 ? two.xy : two.zw;
            if (found.x == check) reference = found.y;
            if (found.x == check || found.x == 0u) break;
        }
        for (int i = 0; i < SBL_CELL_DEPTH && reference >= SBL_CELL_CUT; i++) {
            int cut = int(reference & ~SBL_CELL_CUT);
            uvec2 sides = sbl_cut_sides(cut);
            reference = dot(sbl_cut_normal(cut), position) > sbl_cut_distance(cut) ? sides.y : sides.x;
        }
        patch_word ^= SBL_PATCH_SHORT;
        if ((tries & 1) == 1) {
            patch_word += SBL_PATCH_LEVEL;
            at >>= uint(SBL_LEVEL_SHIFT);
        }
    }
    return int(reference);
}

// Returns R of a leaf, or 0 if leaf is 0. leaf: result of sbl_leaf_at
vec3 sbl_light_of(int leaf) { return leaf == 0 ? vec3(0) : abs(sbl_leaf_light(leaf - 1)); }

// Returns the part of R that rays to glows measure (in lamps.glsl and in sbl_reflect): R of the leaf for long rays
// at this position if that leaf is bright, otherwise 0. leaf: the caller sets it to the result of sbl_leaf_at for
// the same parameters; it becomes the bright leaf, or 0
vec3 sbl_glowing(inout int leaf, int number, bool back, vec3 position, float distance) {
    for (int i = 0; i < (bright_cells > 0 && sbl_is_short(distance) ? 1 : 0); i++)
        leaf = sbl_leaf_at(number, back, position, SBL_UNBOUNDED);
    vec3 light = leaf == 0 || bright_cells == 0 ? vec3(0) : sbl_leaf_light(leaf - 1);
    bool bright = floatBitsToInt(light.r) < 0;
    if (!bright) leaf = 0;
    return bright ? abs(light) : vec3(0);
}

#ifdef SBL_GROUPS
uniform int first_layer;   // texel of sbl_store at which the layers of leaves begin; one texel per leaf and layer

// Returns the part of a leaf's R that a light group causes, or 0 if leaf is 0. leaf: result of sbl_leaf_at
vec3 sbl_layer_of(int leaf, int layer) {
    int texel = first_layer + (leaf - 1) * SBL_GROUPS + layer;
    return leaf == 0 ? vec3(0) : uintBitsToFloat(sbl_fetch(sbl_store, texel).xyz);
}
#endif

// Returns the stored R at a position. Parameters: see sbl_leaf_at
vec3 sbl_stored(int number, bool back, vec3 position, float distance) {
    return sbl_light_of(sbl_leaf_at(number, back, position, distance));
}
#endif
