/* Part of scene_file.h: the poses of animated nodes.

   Only the camera node and its ancestors are animated; all other nodes stay in place. Each node follows the first
   animation of the file that moves it. It rests before its first key and after its last key. */
#ifndef SCENE_MOTION_H
#define SCENE_MOTION_H

#include <math.h>
#include <assimp/scene.h>

/* A node and the animation channel that moves it. */
typedef struct scene__link {
    const struct aiNode *node;
    const struct aiNodeAnim *channel;  /* NULL: the node stands still */
    double rate;                       /* ticks per second */
} scene__link;

typedef struct scene__motion { scene__link *links; size_t count; } scene__motion;  /* from the camera up to the root */

/* Returns the letter L, S, C or - of a node; see scene__name_animated. path: 0 translation, 1 rotation, 2 scale */
static char scene__motion_kind(const struct aiNode *node, int path) {
    const size_t length = node->mName.length;
    return length > 4 ? node->mName.data[length - 4 + (size_t)path] : '-';
}

static const struct aiNodeAnim *scene__channel_of(const struct aiAnimation *in, const struct aiNode *node) {
    unsigned i;
    for (i = 0; i < in->mNumChannels; i++)
        if (strcmp(in->mChannels[i]->mNodeName.data, node->mName.data) == 0) return in->mChannels[i];
    return NULL;
}

/* Lists the nodes from the camera up to the root. Returns 1 if one of them moves in a supported way; otherwise sets the
   error. node: the camera node, or NULL if no camera can be read. The caller frees m->links. */
static int scene__motion_begin(scene__motion *m, scene_file *file, const struct aiScene *in,
                               const struct aiNode *node) {
    const struct aiNode *up;
    size_t i;
    unsigned k;
    int moves = 0, path;
    char kind;
    for (up = node; up; up = up->mParent) m->count++;
    m->links = (scene__link *)calloc(m->count + 1, sizeof *m->links);
    if (!m->links) {
        m->count = 0;
        scene__fail_for_memory(file, "it");
        return 0;
    }
    for (i = 0, up = node; up; up = up->mParent, i++) {
        scene__link *link = &m->links[i];
        link->node = up;
        for (k = 0; k < in->mNumAnimations && !link->channel; k++) {
            link->channel = scene__channel_of(in->mAnimations[k], up);
            link->rate = in->mAnimations[k]->mTicksPerSecond > 0 ? in->mAnimations[k]->mTicksPerSecond : 1000;
        }
        for (path = 0; path < 3 && link->channel; path++) {
            kind = scene__motion_kind(up, path);
            moves |= kind != '-';
            if (kind == 'C')
                scene__fail(file, "its camera moves with CUBICSPLINE keys, which are not read; export LINEAR keys, or "
                            "give the cameras with --cameras FILE");
        }
    }
    if (!moves)
        scene__fail(file, "it has no animated camera, and only .gltf and .glb files can have one; give the cameras "
                    "with --cameras FILE, or leave out --frames");
    return moves && !file->error[0];
}

/* Returns 1 if the animation moves only nodes of m. */
static int scene__motion_has_all(const scene__motion *m, const struct aiAnimation *in) {
    unsigned k;
    size_t i;
    if (!m->count || in->mNumMeshChannels || in->mNumMorphMeshChannels) return 0;
    for (k = 0; k < in->mNumChannels; k++) {
        for (i = 0; i < m->count && m->links[i].channel != in->mChannels[k]; i++) continue;
        if (i == m->count) return 0;
    }
    return 1;
}

/* Returns the weight of the second of two keys at a time, from 0 to 1. */
static double scene__fraction(double time, double first, double second) {
    const double fraction = second > first ? (time - first) / (second - first) : 1;
    return fraction > 0 ? fraction < 1 ? fraction : 1 : 0;
}

/* Returns the index of the last key that is not later than a time, or 0 if all are later. A key begins with its time.
   size: size of a key in bytes */
static unsigned scene__key_at(const void *keys, size_t size, unsigned count, double time) {
    unsigned low = 0, high = count;
    while (high - low > 1) {
        const unsigned middle = low + (high - low) / 2;
        double at;
        memcpy(&at, (const char *)keys + middle * size, sizeof at);
        if (at <= time) low = middle;
        else high = middle;
    }
    return low;
}

/* Interpolates the keys of a translation or a scale. */
static struct aiVector3D scene__vector_at(const struct aiVectorKey *keys, unsigned count, double time, int steps) {
    const unsigned low = scene__key_at(keys, sizeof *keys, count, time);
    struct aiVector3D v = keys[low].mValue;
    double fraction;
    if (steps || low + 1 == count) return v;
    fraction = scene__fraction(time, keys[low].mTime, keys[low + 1].mTime);
    v.x += (ai_real)(fraction * (double)(keys[low + 1].mValue.x - v.x));
    v.y += (ai_real)(fraction * (double)(keys[low + 1].mValue.y - v.y));
    v.z += (ai_real)(fraction * (double)(keys[low + 1].mValue.z - v.z));
    return v;
}

/* Interpolates the keys of a rotation (w, x, y, z) along the shorter arc. */
static void scene__rotation_at(const struct aiNodeAnim *c, double time, int steps, double out[4]) {
    const struct aiQuatKey *keys = c->mRotationKeys;
    const unsigned low = scene__key_at(keys, sizeof *keys, c->mNumRotationKeys, time);
    double fraction, cosine = 0, angle, weights[2], next[4];
    int k;
    out[0] = keys[low].mValue.w; out[1] = keys[low].mValue.x; out[2] = keys[low].mValue.y; out[3] = keys[low].mValue.z;
    if (steps || low + 1 == c->mNumRotationKeys) return;
    next[0] = keys[low + 1].mValue.w; next[1] = keys[low + 1].mValue.x;
    next[2] = keys[low + 1].mValue.y; next[3] = keys[low + 1].mValue.z;
    fraction = scene__fraction(time, keys[low].mTime, keys[low + 1].mTime);
    for (k = 0; k < 4; k++) cosine += out[k] * next[k];
    angle = fabs(cosine) < 0.99999 ? acos(fabs(cosine)) : 0;
    weights[0] = angle > 0 ? sin((1 - fraction) * angle) / sin(angle) : 1 - fraction;
    weights[1] = angle > 0 ? sin(fraction * angle) / sin(angle) : fraction;
    for (k = 0; k < 4; k++) out[k] = weights[0] * out[k] + (cosine < 0 ? -weights[1] : weights[1]) * next[k];
}

/* Computes the transform of a node relative to its parent. frame: seconds per frame */
static void scene__motion_pose(const scene__link *link, double seconds, double frame, struct aiMatrix4x4 *out) {
    const struct aiNodeAnim *c = link->channel;
    struct aiVector3D t = { 0, 0, 0 }, s = { 1, 1, 1 };
    double q[4] = { 1, 0, 0, 0 }, length = 0, times[2];
    int k, steps[3];
    *out = link->node->mTransformation;
    if (!c) return;
    /* The times of keys are rounded. The tolerance prevents that a STEP key at the time of a frame takes effect one
       frame late. */
    times[0] = seconds * link->rate;
    times[1] = (seconds + 0.01 * frame) * link->rate;
    for (k = 0; k < 3; k++) steps[k] = scene__motion_kind(link->node, k) == 'S';
    if (c->mNumPositionKeys) t = scene__vector_at(c->mPositionKeys, c->mNumPositionKeys, times[steps[0]], steps[0]);
    if (c->mNumRotationKeys) scene__rotation_at(c, times[steps[1]], steps[1], q);
    if (c->mNumScalingKeys) s = scene__vector_at(c->mScalingKeys, c->mNumScalingKeys, times[steps[2]], steps[2]);
    for (k = 0; k < 4; k++) length += q[k] * q[k];
    for (k = 0; k < 4; k++) q[k] /= sqrt(length);
    out->a1 = (ai_real)(1 - 2 * (q[2] * q[2] + q[3] * q[3])) * s.x;
    out->a2 = (ai_real)(2 * (q[1] * q[2] - q[0] * q[3])) * s.y;
    out->a3 = (ai_real)(2 * (q[1] * q[3] + q[0] * q[2])) * s.z;
    out->b1 = (ai_real)(2 * (q[1] * q[2] + q[0] * q[3])) * s.x;
    out->b2 = (ai_real)(1 - 2 * (q[1] * q[1] + q[3] * q[3])) * s.y;
    out->b3 = (ai_real)(2 * (q[2] * q[3] - q[0] * q[1])) * s.z;
    out->c1 = (ai_real)(2 * (q[1] * q[3] - q[0] * q[2])) * s.x;
    out->c2 = (ai_real)(2 * (q[2] * q[3] + q[0] * q[1])) * s.y;
    out->c3 = (ai_real)(1 - 2 * (q[1] * q[1] + q[2] * q[2])) * s.z;
    out->a4 = t.x;
    out->b4 = t.y;
    out->c4 = t.z;
    out->d1 = out->d2 = out->d3 = 0;
    out->d4 = 1;
}

#endif
