/* sbl.h - v0.1.0 - sensor based lighting: global illumination in one C header

   Do this once, in one C or C++ file of your program:

       #define SBL_IMPLEMENTATION
       #define SBL_EGL              // optional: sbl.h can make a headless GL context of its own (link with -lEGL)
       #include "sbl.h"

   and include the header without the defines wherever you call it. Needs C99 or C++11, libm, and OpenGL 3.3 core or later.


   WHAT IT IS

   You hand over triangles, materials and a camera; you get back a lit picture. At carefully chosen visible points
   stand virtual cameras, the sensors. Each renders the scene into a small HDR picture whose weighted sum is the light
   that arrives there. Tiles of the picture are refined where neighbouring sensors differ; the rest is interpolated;
   a filter that never mixes surfaces and the surface colour finish the picture. The method is "Sensor based Lighting"
   by M. Banquiero and M. Leone; the differences from the paper are listed under ON THE PAPER below.

       camera --> G-buffer --> tiles --> sensors --> gather --> refine --> filter --> resolve --> final
                  (surface)                 ^            |        |
                                            +------------+--------+   level by level, down to single pixels

   WHAT IT DOES NOT DO

   No light that bounces yet (SBL_MODE_GI is refused), no glossy or transparent surfaces (a metal is read as its base colour), no
   textures smaller than their texels seen from afar (bilinear filtering, no mip maps). It opens no files and creates no windows.


   QUICK START

       #define SBL_IMPLEMENTATION
       #define SBL_EGL
       #include "sbl.h"

       int main(void) {
           static const float corners[] = {  // a floor and, above it, a lamp
               -1, 0, -1,   -1, 0, 1,    1, 0, 1,    1, 0, -1,
               -.3f, 1, -.3f,   .3f, 1, -.3f,   .3f, 1, .3f,   -.3f, 1, .3f };
           static const unsigned short quad[] = { 0, 1, 2, 0, 2, 3 };
           static float picture[64 * 64 * 3];
           static sbl_material materials[2];
           static sbl_mesh meshes[2];
           sbl_scene_desc scene = { 0 };
           sbl_picture_desc view = { 0 };
           sbl_context *context;
           int i;
           for (i = 0; i < 3; i++) { materials[0].albedo[i] = 0.7f; materials[1].emission[i] = 5; }
           for (i = 0; i < 2; i++) {
               meshes[i].positions.data = corners + 12 * i;
               meshes[i].vertex_count = 4;
               meshes[i].indices.data = quad;
               meshes[i].indices.type = SBL_UINT16;
               meshes[i].index_count = 6;
               meshes[i].material = i;
           }
           scene.meshes = meshes;        scene.mesh_count = 2;
           scene.materials = materials;  scene.material_count = 2;
           view.width = view.height = 64;
           sbl_look_at(view.world_to_view, 0, 1.5f, 3, 0, 0.4f, 0, 0, 1, 0);
           sbl_perspective(view.view_to_clip, 40, 1);
           if (sbl_create(NULL, &context) != SBL_SUCCESS) return 1;
           if (sbl_set_scene(context, &scene) != SBL_SUCCESS || sbl_render(context, &view) != SBL_SUCCESS) return 1;
           sbl_read_channel(context, SBL_CHANNEL_FINAL, picture, 64 * 64 * 3);
           sbl_destroy(context);
           return 0;
       }


   FUNCTIONS

       sbl_create                 a context in the host's GL context, or in a headless one of its own
       sbl_destroy                frees all of it
       sbl_set_scene              replaces the scene: meshes, materials, textures, lights, sky
       sbl_set_mesh_transform     moves one mesh
       sbl_query_bounds           the scene's extent
       sbl_render                 a whole picture in one call
       sbl_begin                  the same in steps: begin, step until done, end
       sbl_step                   works for about so many seconds
       sbl_progress               how far the picture is, 0 to 1
       sbl_end                    abandons the picture or frees a finished one
       sbl_read_channel           a result as a float array
       sbl_channel_texture        a result as a GL texture
       sbl_channel_components     floats per pixel of a channel
       sbl_inspect_sensor         what one sensor sees, weighs and sums: "why is this pixel dark?"
       sbl_look_at                helper: world_to_view
       sbl_perspective            helper: view_to_clip
       sbl_context_desc_defaults  a descriptor with its zeros replaced by the defaults
       sbl_picture_desc_defaults  likewise
       sbl_query_desc             the context's descriptor, defaults filled in
       sbl_query_capabilities     which GL, which optional features are in use
       sbl_query_stats            counts and seconds of the current picture
       sbl_query_memory           bytes in use and at peak
       sbl_version                "0.1.0"
       sbl_result_string          a result in words
       sbl_log_item_string        a log item's name


   ON UNITS

   Scene-linear radiance in any consistent unit; lengths in any unit from 0.01 to 10,000 across the scene and beyond.
   For a surface point p with normal n:

       E(p) = integral over the hemisphere of L(p, w) cos(theta) dw      irradiance
       R(p) = E(p) / pi                                                  the radiance map; a uniform sky of radiance 1 gives 1
       final = emission(p) + albedo(p) * R(p)

   Surfaces are Lambertian, reflect on both sides and emit on both sides unless a material says one-sided.
   Matrices are column-major, as GL has them; view space looks down -z. Pixel (0, 0) is the top left one; a pixel is
   sampled at its centre. Arrays and textures hold the top row first (texture coordinate v = 0 is the top edge).

   ON MEMORY

   Everything is allocated through the descriptor's allocator, or malloc and free. sbl_set_scene copies what it is given:
   arrays, textures and GL buffers may be freed afterwards. Running out of memory is a result (SBL_ERROR_OUT_OF_MEMORY),
   and leaves the context usable: the scene or picture being made is dropped, an older scene stays.

   ON ERRORS

   Every function that can fail returns an sbl_result; what went wrong, where, and what to change goes to the logger as one
   line a mistake. Descriptors are checked whole, in release builds too: all mistakes in one are reported in one call,
   and a descriptor with a mistake changes nothing. Functions accept a NULL context (SBL_ERROR_INVALID_ARGUMENT).

   ON THREADS

   No globals: contexts are independent. One context must not be used by two threads at once, and its GL context must be current.

   ON GL STATE

   Functions that use GL read the state they are about to change and put it back before they return, on failure and
   cancel too: framebuffers, program, vertex array, buffers, textures, samplers and images of the units they use, viewport,
   scissor, depth, stencil, blend, cull, masks, clear values, polygon mode, pixel store, sRGB, clip distances, depth
   clamp, clip control, and so on. With a headless context of its own the EGL binding is put back instead. GL errors
   that the host left behind are cleared. A conditional render, a transform feedback and queries that count samples or primitives must not be
   active during the calls: they cannot be set aside, and would drop or count sbl.h's own drawing. All sbl functions that touch GL need the same GL context current that
   sbl_create was called in; sbl_destroy too.

   ON DETERMINISM

   Sensor rotations come from a hash of pixel and seed. The same input gives the same picture, bit for bit, on the same GL driver,
   whatever the batch size, the slices and the number of repetitions; between GL paths and drivers it agrees up to rounding.

   ON LIGHTS

   Surfaces emit (sbl_material.emission); point, spot and directional lights shine (sbl_light); the sky does, constant, by a picture or by a
   function (sbl_environment). What an emitting triangle, a sphere or a sun gives unhindered is computed in closed form, with the
   horizon; rays only measure which share of it arrives. So light is exact where all of a lamp is seen, black where none is, and its
   noise is that of a share in between. An eighth of `rays`, and a look at corners and rims, tells whether all or nothing arrives; where neither does, or lamps are many, the rest
   are traced too. A light without size gets one ray, up to 32 of them.
   Up to 256 lamps are weighed one by one. Of more, those far off for their size stand together in clusters of a tree, of which rays pick single
   ones in proportion to what they give: the cost of a sensor hardly grows from there on, and the mean stays right; the noise is a few percent.
   Of a sky picture, what is brighter than four times its mean is a lamp of that kind, so that a sun in it casts a clean shadow; the rest is met
   by the rays over the hemisphere.


   ON THE TWO WAYS TO SEE

   SBL_BACKEND_TRACE sends `rays` cosine-distributed rays through a bounding volume hierarchy in a compute shader, or a fragment shader before
   GL 4.3, and at most as many more to lamps (stats.rays does not count these): its cost hardly grows with the scene. The sensors' noise is known, so that
   refinement follows light and not noise, and the filter leaves alone what noise does not explain.
   SBL_BACKEND_RASTER draws the scene into a sensor's views, as the paper does: it serves geometry that only the host can draw, and is the
   check on the other. Its cost grows with the number of triangles. Lamps get rays here too, which meet the meshes; what a draw callback draws stands
   between where the views show it, and what it emits is met by texels. AUTO traces wherever rays can be traced.


   ON THE PAPER

   SBL_MODE_PAPER is the paper: one view of 135 degrees, equation 4, epsilon, the absolute threshold, the Gaussian on one id; emitters are met by
   texels, and there are no lights besides.
   All other modes differ in this: a sensor is a hemicube (five views: nothing of the hemisphere is missed), rotated about the
   normal by a per-pixel hash, its weights the texels' exact projected solid angles; the threshold is relative;
   interpolation and filter also respect normals and planes.
*/

#ifndef SBL_INCLUDED
#define SBL_INCLUDED

#include <stddef.h>
#include <stdint.h>

#define SBL_VERSION_MAJOR 0
#define SBL_VERSION_MINOR 1
#define SBL_VERSION_PATCH 0

/* SBL_STATIC makes every function private to the one file that holds the implementation. */
#ifndef SBL_API
  #if defined(SBL_STATIC) && defined(__GNUC__)
    #define SBL_API static __attribute__((unused))
  #elif defined(SBL_STATIC)
    #define SBL_API static
  #elif defined(__cplusplus)
    #define SBL_API extern "C"
  #else
    #define SBL_API extern
  #endif
#endif

typedef struct sbl_context sbl_context;

/* >>results */

typedef enum sbl_result {
    SBL_SUCCESS = 0,
    SBL_UNFINISHED,              /* not an error: call sbl_step again */
    SBL_CANCELLED,               /* the progress callback asked for it */
    SBL_ERROR_INVALID_ARGUMENT,  /* a descriptor or parameter is out of range; the log names each field and value */
    SBL_ERROR_OUT_OF_MEMORY,     /* host or GPU memory */
    SBL_ERROR_UNSUPPORTED,       /* the GL context, or this version of sbl.h, cannot do this */
    SBL_ERROR_STATE,             /* called in the wrong order: no scene yet, no picture yet, a picture under way */
    SBL_ERROR_GL,                /* GL reported an error, or a shader did not compile (a driver bug: the log has its words) */
    SBL_RESULT_COUNT
} sbl_result;

typedef enum sbl_log_level { SBL_LOG_ERROR, SBL_LOG_WARNING, SBL_LOG_INFO } sbl_log_level;

/* Every message belongs to one item, so that a host can filter without reading text. */
#define SBL_LOG_ITEMS(X)                                                              \
    X(OK, "nothing to report")                                                        \
    X(INVALID_ARGUMENT, "a parameter is out of range")                                \
    X(INVALID_CONTEXT_DESC, "a field of sbl_context_desc is out of range")            \
    X(INVALID_SCENE_DESC, "a field of sbl_scene_desc is out of range")                \
    X(INVALID_MESH, "a mesh is not usable")                                           \
    X(INVALID_MATERIAL, "a material is not usable")                                   \
    X(INVALID_TEXTURE, "a texture is not usable")                                     \
    X(INVALID_LIGHT, "a light or the environment is not usable")                      \
    X(INVALID_PICTURE_DESC, "a field of sbl_picture_desc is out of range")            \
    X(WRONG_ORDER, "a function was called before what it needs")                      \
    X(OUT_OF_MEMORY, "memory could not be allocated")                                 \
    X(TOO_LARGE, "more than the GL context or the index range can hold")              \
    X(NO_GL, "no usable GL context")                                                  \
    X(GL_FUNCTION_MISSING, "the GL loader did not find a function")                   \
    X(GL_ERROR, "GL reported an error")                                               \
    X(SHADER_COMPILE, "a shader did not compile")                                     \
    X(SHADER_LINK, "a shader program did not link")                                   \
    X(FRAMEBUFFER, "a framebuffer is not complete")                                   \
    X(NOT_IMPLEMENTED, "this version cannot do that yet")                             \
    X(DEGENERATE_TRIANGLES, "triangles without area were left out")                   \
    X(NOTHING_VISIBLE, "the camera sees no surface")                                  \
    X(INFO, "information")

#define SBL__X(name, text) SBL_LOG_ITEM_##name,
typedef enum sbl_log_item { SBL_LOG_ITEMS(SBL__X) SBL_LOG_ITEM_COUNT } sbl_log_item;
#undef SBL__X

/* >>context types */

typedef void (*sbl_gl_function)(void);

typedef struct sbl_allocator {
    void *(*alloc)(size_t bytes, void *user);  /* NULL means out of memory */
    void (*free)(void *pointer, void *user);   /* never called with NULL */
    void *user;
} sbl_allocator;

typedef struct sbl_logger {
    void (*log)(sbl_log_level level, sbl_log_item item, const char *message, void *user);
    void *user;
} sbl_logger;

/* Optional GL features; a bit in sbl_context_desc.disabled makes sbl.h act as if the driver did not have it. */
typedef enum sbl_capability {
    SBL_CAPABILITY_CLIP_CONTROL = 1 << 0,  /* GL 4.5 or ARB_clip_control: depth from 1 (near) to 0 (infinity) without a shader writing it */
    SBL_CAPABILITY_COMPUTE = 1 << 1,       /* GL 4.3: rays are traced by compute shaders instead of fragment shaders; llvmpipe: 2 to 15 % faster, bit for bit the same */
    SBL_CAPABILITY_ALL = (1 << 2) - 1
} sbl_capability;

/* All of it may be zero. */
typedef struct sbl_context_desc {
    uint32_t start_canary;  /* leave zero: found when the struct was not zeroed */
    sbl_gl_function (*get_gl_function)(const char *name, void *user);  /* such as eglGetProcAddress; NULL: make a headless context (needs SBL_EGL) */
    void *gl_user;
    sbl_allocator allocator;  /* default: malloc and free; give both functions or none */
    sbl_logger logger;        /* default: errors and warnings to stderr, one line each; define SBL_NO_STDIO for silence */
    uint32_t disabled;        /* sbl_capability bits to do without, for tests. Default: none */
    int atlas_size;           /* texels across the texture that holds a batch of sensors, 256 to 16384; 0: 2048, or what the driver can. Other sizes differ by rounding */
    int batch;                /* sensors drawn in one call, at most what the atlas holds; 0: all that fit. Never changes a picture */
    uint32_t end_canary;
} sbl_context_desc;

typedef struct sbl_capabilities {
    int gl_major, gl_minor;
    uint32_t available;       /* sbl_capability bits that the driver has */
    uint32_t used;            /* those less sbl_context_desc.disabled */
    int max_texture_size;
    int max_texture_buffer_size;  /* texels; scenes of more (3 a triangle, 2 a vertex, 5 a mesh) are read from 2D textures: 15 to 45 % slower on llvmpipe */
    char renderer[128];       /* GL_RENDERER */
    char version[128];        /* GL_VERSION */
} sbl_capabilities;

typedef struct sbl_memory {
    size_t host_bytes, host_peak_bytes;
    size_t gpu_bytes, gpu_peak_bytes;  /* what was asked of GL: textures and buffers; a driver may use more */
} sbl_memory;

/* >>scene types */

typedef enum sbl_type {
    SBL_FLOAT32 = 0,
    SBL_FLOAT16,
    SBL_UINT8_NORM,   /* 0..255 is 0..1; colours and texture coordinates only */
    SBL_UINT16_NORM,  /* 0..65535 is 0..1 */
    SBL_INT8_NORM,    /* -127..127 is -1..1 */
    SBL_INT16_NORM,
    SBL_UINT8,        /* whole numbers: indices */
    SBL_UINT16,
    SBL_UINT32,
    SBL_TYPE_COUNT
} sbl_type;

/* One vertex attribute, or the indices. Absent when both data and gl_buffer are zero. */
typedef struct sbl_stream {
    const void *data;    /* client memory; copied */
    uint32_t gl_buffer;  /* or a GL buffer; read back once */
    size_t offset;       /* bytes from data or from the buffer's start */
    size_t stride;       /* bytes from element to element; 0: tightly packed */
    sbl_type type;       /* of each component */
} sbl_stream;

/* A triangle list. Winding matters only to one-sided emission: the front is where the corners run counter-clockwise. */
typedef struct sbl_mesh {
    sbl_stream positions;  /* 3 components; required */
    sbl_stream normals;    /* 3; object space, any length. Absent: flat */
    sbl_stream texcoords;  /* 2; v = 0 is the texture's first row. Absent: 0 0 */
    sbl_stream colors;     /* 4: linear rgb and alpha, multiplied with the material's albedo. Absent: 1 1 1 1 */
    sbl_stream indices;    /* SBL_UINT8, SBL_UINT16 or SBL_UINT32. Absent: 0 1 2, 3 4 5, ... */
    int vertex_count;
    int index_count;       /* a multiple of 3; ignored without indices */
    float transform[16];   /* object to world, column-major, affine. All zero: identity */
    int material;          /* index into sbl_scene_desc.materials */
    uint32_t id;           /* surfaces with the same id may be filtered together; 0: the mesh's index + 1 */
} sbl_mesh;

typedef enum sbl_material_flag {
    SBL_MATERIAL_ONE_SIDED_EMISSION = 1 << 0,  /* the back side does not shine */
    SBL_MATERIAL_HIDDEN_FROM_CAMERA = 1 << 1,
    SBL_MATERIAL_HIDDEN_FROM_SENSORS = 1 << 2, /* neither lights nor shadows anything */
    SBL_MATERIAL_FLAGS_ALL = (1 << 3) - 1
} sbl_material_flag;

/* Zero is taken literally here: black, no light, no textures, no cutout. */
typedef struct sbl_material {
    float albedo[3];       /* share of light reflected, 0 to 1 each, linear */
    float emission[3];     /* radiance, 0 and up */
    int albedo_texture;    /* number of a texture counted from 1, times albedo; 0: none */
    int emission_texture;  /* likewise, times emission */
    float alpha_cutoff;    /* a point whose alpha (albedo texture's times vertex colour's) is below this is not there; 0: solid */
    uint32_t flags;        /* sbl_material_flag bits */
} sbl_material;

typedef enum sbl_pixel_format {
    SBL_PIXELS_SRGB8 = 0,  /* 8-bit, colour decoded from sRGB, alpha linear */
    SBL_PIXELS_LINEAR8,    /* 8-bit, 0..255 is 0..1 */
    SBL_PIXELS_FLOAT,      /* 32-bit float, linear; stored with 16 bits */
    SBL_PIXEL_FORMAT_COUNT
} sbl_pixel_format;

typedef enum sbl_wrap { SBL_WRAP_REPEAT = 0, SBL_WRAP_CLAMP, SBL_WRAP_COUNT } sbl_wrap;

/* Filtered bilinearly, without mip maps. */
typedef struct sbl_texture {
    const void *pixels;       /* client memory; copied */
    uint32_t gl_texture;      /* or a GL_TEXTURE_2D; level 0 is copied as sampling it gives it */
    sbl_pixel_format format;  /* of pixels; with gl_texture: SRGB8 stores 8 bits, FLOAT 16 */
    int width, height;        /* with gl_texture: 0, read from GL */
    int channels;             /* 1 grey, 2 grey and alpha, 3 rgb, 4 rgba; 0: 4 */
    size_t stride;            /* bytes from row to row; 0: tightly packed */
    sbl_wrap wrap;            /* default: repeat */
} sbl_texture;

typedef enum sbl_light_kind { SBL_LIGHT_POINT = 0, SBL_LIGHT_SPOT, SBL_LIGHT_DIRECTIONAL, SBL_LIGHT_KIND_COUNT } sbl_light_kind;

/* A light that is no surface: the camera and sensors do not see it, and it casts no shadow. Kinds and units follow glTF's KHR_lights_punctual: where
   radiance is in nits and lengths are in metres, intensities are in candela and in lux. What a light gives does not end at a range. */
typedef struct sbl_light {
    sbl_light_kind kind;
    float intensity[3];       /* point, spot: radiance times area, light per solid angle; a surface at distance d that faces it has the irradiance
                                 intensity / d^2. Directional: the irradiance of a surface that faces it */
    float position[3];        /* point, spot: world */
    float direction[3];       /* spot, directional: the way its light goes; any length but 0 */
    float radius;             /* point, spot: of an evenly shining sphere, whose radiance is intensity / (pi radius^2): soft shadows. 0: a point */
    float angle;              /* directional: angular diameter, degrees, 0 (a point far away) to 180; the sun's is 0.53 */
    float cone;               /* spot: full angle, degrees, to 180, that has any of the light. Default: 90 */
    float inner_cone;         /* spot: full angle, degrees, to cone, that has all of it. Between them the cosine's share of the way, squared */
} sbl_light;

/* Light from far away, in a picture or a function; it comes on top of the constant sky. In SBL_MODE_PAPER there is neither this nor any sbl_light.
   A direction d has u = 0.5 + atan2(d . z, d . x) / (2 pi), v = acos(d . up) / pi; x, z are the world's where up is +y, and turn with up the shortest way
   where not. (0, 0) is the picture's first corner: its upper edge is all straight up. */
typedef struct sbl_environment {
    sbl_texture picture;      /* equirectangular; pixels of any format, finite and not negative (no gl_texture, no wrap). Absent: width 0 */
    void (*radiance)(const float direction[3], float radiance[3], void *user);  /* or a function of a unit direction in the world, called in sbl_set_scene for
                                 every texel's middle of a picture of picture.width x height. Default: 512 x 256 */
    void *user;
    float scale;              /* of its light. Default: 1 */
    float rotation;           /* of the picture about `up`, degrees, counter-clockwise seen from above */
    float up[3];              /* default: 0 1 0 */
} sbl_environment;

/* >>draw callback types: geometry that only the host can draw */

typedef enum sbl_view_kind { SBL_VIEW_CAMERA = 0, SBL_VIEW_SENSOR } sbl_view_kind;

/* What the host's draw callback is told. The framebuffer, viewport and scissor are set, the depth test is on and its function
   chosen; keep them. Everything else may be changed: sbl.h sets its own state again afterwards and puts the host's back at the end.

   Outputs of the fragment shader, SBL_VIEW_SENSOR:
       location 0  vec4: rgb = radiance towards the sensor times radiance_scale; a = gl_FrontFacing ? 1.0 / gl_FragCoord.w : -1.0 / gl_FragCoord.w
   Outputs, SBL_VIEW_CAMERA:
       location 0  vec4: world position, a = 0
       location 1  vec4: unit shading normal towards the camera, a = 0
       location 2  vec4: unit geometric normal towards the camera, a = 0
       location 3  vec4: albedo, a = 1
       location 4  vec4: emission, a = 0
       location 5  uint: id, not 0
   gl_Position = world_to_clip * vec4(world position, 1). Depth is reversed (nearer is greater). If write_depth is set the
   fragment shader must also do  gl_FragDepth = gl_FragCoord.w * depth_scale  (the driver has no clip control).

   What it costs: meshes given as vertex arrays are drawn for a whole batch of sensors in one call; the callback is called once for
   every view of every sensor (five a hemicube), so its price is the host's own draw calls times 5 times the sensors. */
typedef struct sbl_draw_view {
    sbl_view_kind kind;
    int viewport[4];          /* x, y, width, height in the current framebuffer; the scissor is the same */
    float world_to_view[16];  /* rigid; view space looks down -z, y is up */
    float view_to_clip[16];   /* reversed, infinite depth */
    float world_to_clip[16];  /* the product of the two */
    float eye[3];             /* world position of the sensor or camera */
    float radiance_scale;     /* keeps bright lamps inside the texels' range */
    float depth_scale;
    int write_depth;          /* 1: the shader must write gl_FragDepth, see above */
    float epsilon;            /* the ambient factor of the paper, 0 in direct mode: non-emitters radiate epsilon * albedo */
    int sensor, face;         /* SBL_VIEW_SENSOR: number within its level; face 0 looks along the normal */
} sbl_draw_view;

typedef void (*sbl_draw_function)(const sbl_draw_view *view, void *user);

typedef struct sbl_scene_desc {
    uint32_t start_canary;
    const sbl_mesh *meshes;
    int mesh_count;
    const sbl_material *materials;
    int material_count;
    const sbl_texture *textures;
    int texture_count;
    const sbl_light *lights;   /* besides the surfaces that emit */
    int light_count;
    float sky[3];              /* constant radiance of all that is not hit */
    sbl_environment environment;
    sbl_draw_function draw;    /* optional: see sbl_draw_view */
    void *draw_user;
    float draw_bounds[2][3];   /* world bounds (lowest corner, highest corner) of what draw draws; required with it */
    float draw_max_radiance;   /* highest radiance that draw writes, so that texels do not overflow. Default: 1 */
    uint32_t end_canary;
} sbl_scene_desc;

/* >>picture types */

typedef enum sbl_mode {
    SBL_MODE_DEFAULT = 0,  /* AMBIENT, until bounced light exists: then GI */
    SBL_MODE_AMBIENT,      /* emitters, lights, sky, and every other surface glowing with epsilon * albedo: the paper's estimator over the whole hemisphere */
    SBL_MODE_DIRECT,       /* emitters, lights and sky only */
    SBL_MODE_PAPER,        /* exactly the paper */
    SBL_MODE_GI,           /* all bounces: SBL_ERROR_UNSUPPORTED in this version */
    SBL_MODE_COUNT
} sbl_mode;

typedef enum sbl_preset { SBL_PRESET_DEFAULT = 0, SBL_PRESET_DRAFT, SBL_PRESET_HIGH, SBL_PRESET_COUNT } sbl_preset;

typedef enum sbl_sensor_kind {
    SBL_SENSOR_DEFAULT = 0,  /* HEMICUBE; SINGLE in SBL_MODE_PAPER */
    SBL_SENSOR_HEMICUBE,     /* five views, the whole hemisphere */
    SBL_SENSOR_SINGLE,       /* the paper's one view along the normal, sensor_fov wide, blind outside but for lamps */
    SBL_SENSOR_KIND_COUNT
} sbl_sensor_kind;

/* How sensors see. Both give the same light up to their noise. */
typedef enum sbl_backend {
    SBL_BACKEND_AUTO = 0,    /* TRACE; RASTER in SBL_MODE_PAPER, with a draw callback and with SBL_SENSOR_SINGLE */
    SBL_BACKEND_RASTER,      /* views drawn into texels, as in the paper: cost grows with the number of triangles */
    SBL_BACKEND_TRACE,       /* rays through a bounding volume hierarchy in a shader: cost grows with its logarithm. No draw callback, not in SBL_MODE_PAPER */
    SBL_BACKEND_COUNT
} sbl_backend;

/* Zero is the default everywhere. Where two or three numbers stand: draft / default / high preset. */
typedef struct sbl_picture_desc {
    uint32_t start_canary;
    int width, height;         /* pixels, 1 to 16384. Default: 640 480 */
    float world_to_view[16];   /* rigid. Default (all zero): frames the scene from the front, see sbl_look_at */
    float view_to_clip[16];    /* perspective, or orthographic, which sees what is behind it too; near and far planes are ignored. Default: 40 degrees */
    sbl_mode mode;
    sbl_preset preset;
    sbl_sensor_kind sensor_kind;
    sbl_backend backend;
    int rays;                  /* of a traced sensor, 1 to 4096, and at most as many more towards lamps. Default: 64 / 256 / 1024 */
    int sensor_size;           /* of a rasterised sensor: texels across a view, 4 to 512. Default: 32 / 64 / 128 */
    float sensor_fov;          /* degrees, SBL_SENSOR_SINGLE only, 1 to 179. Default: 135 */
    int tile;                  /* first distance between sensors in pixels, 1 (every pixel) to 1024. Default: 16 / 16 / 8 */
    float threshold;           /* refine where neighbours differ by more: a share of their mean, in SBL_MODE_PAPER a radiance. Default: 0.3 / 0.15 / 0.07, paper 0.05 */
    float epsilon;             /* ambient factor. Default: 0.02 (SBL_MODE_DIRECT: always 0) */
    float facet_limit;         /* pixels: triangles of smaller height on the screen are lit by their true normals, since shading normals are there to hide
                                  facets that can be seen; those of twice as much by their shading normals. 0: shading normals everywhere */
    int filter_radius;         /* of the Gaussian, pixels, at most 32; negative: no filter. Default: 2 */
    int samples;               /* anti-aliasing of `final`, samples a pixel, 1 to 64. Default: 1 / 4 / 16 */
    uint32_t seed;             /* of the sensors' rotations */
    int (*progress)(float done, void *user);  /* done: 0 to 1; return nonzero to cancel */
    void *progress_user;
    uint32_t end_canary;
} sbl_picture_desc;

/* What can be read. Components are floats. Where the camera sees nothing all are 0 but final, which shows the sky. */
typedef enum sbl_channel {
    SBL_CHANNEL_FINAL = 0,  /* 3: emission + albedo * R, anti-aliased */
    SBL_CHANNEL_RADIANCE,   /* 3: R, filtered, at pixel centres */
    SBL_CHANNEL_ALBEDO,     /* 3 */
    SBL_CHANNEL_NORMAL,     /* 3: unit, world space, towards the camera */
    SBL_CHANNEL_POSITION,   /* 3: world space */
    SBL_CHANNEL_ID,         /* 1 */
    SBL_CHANNEL_DEPTH,      /* 1: distance along the view axis */
    SBL_CHANNEL_SENSORS,    /* 1: 0 interpolated, else 1 + the level at which a sensor stood here */
    SBL_CHANNEL_COUNT
} sbl_channel;

#define SBL_MAX_LEVELS 16

typedef struct sbl_stats {
    sbl_mode mode;
    sbl_backend backend;      /* RASTER or TRACE */
    int width, height;
    int triangles;            /* in the scene, degenerate ones left out */
    int visible_pixels;       /* pixels that show a surface */
    int64_t sensors;          /* points at which light was gathered */
    int64_t sensor_views;     /* views drawn for them; a sensor that stands for many pixels looks up to four times */
    int64_t sensor_texels;
    int lamps;                /* emitting triangles, lights and bright texels of the sky that sensors aim rays at */
    int64_t rays;             /* traced over the hemispheres; those towards lamps come on top */
    double bvh_seconds;       /* building the hierarchy, once per scene, part of seconds.surface of its first traced picture */
    size_t bvh_bytes;         /* on the GPU */
    int64_t invalid_sensors;  /* stuck inside geometry; their neighbours' light was used instead */
    int level_count;
    struct { int tile; int64_t sensors; } levels[SBL_MAX_LEVELS];
    int readbacks;            /* transfers from GPU to host during the picture */
    struct { double scene, surface, gather, refine, filter, resolve, total; } seconds;
    double microseconds_per_sensor;  /* total over sensors, as in the paper */
} sbl_stats;

/* >>inspection types */

typedef struct sbl_sensor_view {
    int rect[4];              /* x, y, width, height in the sheet; y counts from the first row */
    float right[3], up[3], forward[3];  /* unit; texel (i, j) of the rect looks along forward + right * x + up * y with */
    float x0, x1, y0, y1;     /* x = x0 + (x1 - x0) * (i + 0.5) / width, and likewise y with j */
} sbl_sensor_view;

/* One sensor as it stood in the last picture, all its views on one sheet:

       hemicube, size S:  +--------+--------+        single:  +--------+
                          |        | side 1 |                 |        |
                          |  top   +--------+                 |  top   |
                          |        | side 2 |                 |        |
                          +--------+--------+                 +--------+
                          | side 3 | side 4 |     a side holds the half above the horizon
                          +--------+--------+                                                     */
typedef struct sbl_sensor {
    float position[3];        /* where it stands: the surface point moved off the surface */
    float normal[3];
    float radiance[3];        /* R: the sum over texels of weight * radiance, before interpolation and filter: what a rasterised sensor of the picture's
                                 sensor_size, that meets emitters by its texels, gives for the first of the pixel's looks. No sbl_light is in it */
    float weight_sum;         /* 1 for a hemicube */
    float back_share;         /* share of the weight that sees back faces */
    float hit_min, hit_mean;  /* distance to the nearest surface seen, and the mean; 0 where none is seen */
    int valid;                /* 0: judged to be stuck inside geometry */
    int sensed;               /* 0: no sensor stood here, its pixel was interpolated; what is shown was gathered now */
    int level;
    int view_count;
    sbl_sensor_view views[5];
    int sheet_width, sheet_height;
} sbl_sensor;

/* >>functions */

/* Makes a context. desc: NULL or zeroes mean defaults. out: receives the context, NULL on failure.
   Results: INVALID_ARGUMENT, OUT_OF_MEMORY, UNSUPPORTED (no GL 3.3, a function missing, no headless GL), GL. */
SBL_API sbl_result sbl_create(const sbl_context_desc *desc, sbl_context **out);

/* Frees the context and all its GL objects; NULL is ignored. */
SBL_API void sbl_destroy(sbl_context *context);

/* Replaces the scene by a copy of what desc describes. A picture under way is abandoned. An empty scene is allowed: only sky.
   Triangles without area are left out, with a warning.
   Results: INVALID_ARGUMENT (each mistake logged with its mesh, field and value), OUT_OF_MEMORY, UNSUPPORTED (too large), GL.
   On failure the former scene stays. */
SBL_API sbl_result sbl_set_scene(sbl_context *context, const sbl_scene_desc *desc);

/* Moves mesh number `mesh` of the scene: transform is object to world, as sbl_mesh.transform. A picture under way is abandoned.
   Results: INVALID_ARGUMENT, STATE (no scene), OUT_OF_MEMORY, GL. On failure the mesh stays where it was. */
SBL_API sbl_result sbl_set_mesh_transform(sbl_context *context, int mesh, const float transform[16]);

/* World bounds of the scene; 0 0 0 both where it is empty. Results: INVALID_ARGUMENT, STATE. */
SBL_API sbl_result sbl_query_bounds(const sbl_context *context, float lowest[3], float highest[3]);

/* Renders a picture: sbl_begin, then sbl_step until done. Results: those of both. */
SBL_API sbl_result sbl_render(sbl_context *context, const sbl_picture_desc *desc);

/* Starts a picture. desc: NULL or zeroes mean defaults; copied. The former picture is dropped.
   Results: INVALID_ARGUMENT, STATE (no scene), UNSUPPORTED (SBL_MODE_GI; larger than the driver's textures), OUT_OF_MEMORY, GL. */
SBL_API sbl_result sbl_begin(sbl_context *context, const sbl_picture_desc *desc);

/* Works on the picture for about `seconds` (at least one batch; 0 or less: until it is done).
   Results: SUCCESS (done: channels can be read), UNFINISHED, CANCELLED, STATE (no picture), OUT_OF_MEMORY, GL.
   After CANCELLED or an error the picture is gone. */
SBL_API sbl_result sbl_step(sbl_context *context, double seconds);

/* How far the picture is, 0 to 1; 0 without one. An estimate: refinement may still find work. */
SBL_API float sbl_progress(const sbl_context *context);

/* Abandons the picture under way, or frees the finished one's channels. */
SBL_API void sbl_end(sbl_context *context);

/* Floats per pixel of a channel: 3 or 1; 0 for a channel that does not exist. */
SBL_API int sbl_channel_components(sbl_channel channel);

/* Copies a channel of the finished picture: width * height * components floats, top row first.
   count: floats that `out` has room for. Results: INVALID_ARGUMENT, STATE (no finished picture), OUT_OF_MEMORY, GL. */
SBL_API sbl_result sbl_read_channel(sbl_context *context, sbl_channel channel, float *out, size_t count);

/* The GL texture that holds a channel of the finished picture, 0 without one: GL_TEXTURE_2D, width x height, top row first, NEAREST.
   RGBA32F or RGBA16F; ID is R32UI, DEPTH and SENSORS R32F. Owned by sbl.h; valid until the next sbl_begin, sbl_set_scene or sbl_end. */
SBL_API uint32_t sbl_channel_texture(sbl_context *context, sbl_channel channel);

/* Gathers light again for pixel (x, y) of the finished picture and shows how it came about.
   radiance: NULL, or 4 floats a texel of the sheet, first row first: rgb = radiance, a = distance to what was seen, negative for back faces, 0 for
   nothing. weights: NULL, or 1 float a texel, their sum is sensor->weight_sum. count: texels that both have room for;
   call with NULL arrays first to learn sheet_width and sheet_height.
   Results: INVALID_ARGUMENT (outside the picture, no surface there, no room), STATE, OUT_OF_MEMORY, GL. */
SBL_API sbl_result sbl_inspect_sensor(sbl_context *context, int x, int y, sbl_sensor *sensor, float *radiance, float *weights, size_t count);

/* world_to_view of a camera at `eye` that looks at `at`. Returns 0 and writes nothing where the directions are degenerate, else 1. */
SBL_API int sbl_look_at(float world_to_view[16], float eye_x, float eye_y, float eye_z, float at_x, float at_y, float at_z,
                        float up_x, float up_y, float up_z);

/* view_to_clip of a pinhole camera; fov_y: vertical, degrees; aspect: width / height. Returns 0 and writes nothing where they are out of range, else 1. */
SBL_API int sbl_perspective(float view_to_clip[16], float fov_y, float aspect);

/* Copies with every zero that means a default replaced by it; NULL is all zeroes. */
SBL_API sbl_context_desc sbl_context_desc_defaults(const sbl_context_desc *desc);
SBL_API sbl_picture_desc sbl_picture_desc_defaults(const sbl_picture_desc *desc);

SBL_API sbl_context_desc sbl_query_desc(const sbl_context *context);
SBL_API sbl_capabilities sbl_query_capabilities(const sbl_context *context);
SBL_API sbl_stats sbl_query_stats(const sbl_context *context);
SBL_API sbl_memory sbl_query_memory(const sbl_context *context);

SBL_API const char *sbl_version(void);
SBL_API const char *sbl_result_string(sbl_result result);
SBL_API const char *sbl_log_item_string(sbl_log_item item);

#endif /* SBL_INCLUDED */

/* Stop here if you only want to use it: all that follows is the implementation. */

#ifdef SBL_IMPLEMENTATION
#ifndef SBL_IMPLEMENTATION_INCLUDED
#define SBL_IMPLEMENTATION_INCLUDED

/* The rooms, in the order of execution; each calls only rooms above it. Search for the tag:

       >>shaders  the GLSL of shaders_embedded/        >>gather   points -> light, with rasterised views
       >>base     config, log, memory, math            >>refine   which points get sensors; interpolation
       >>gl       loader, state guard, objects         >>filter   smoothing of R
       >>scene    meshes, materials, textures -> GPU   >>resolve  composition, anti-aliasing, readback
       >>bvh      the hierarchy that rays go through   >>picture  the stages in steps
       >>lamps    what sensors aim rays at             >>public   the functions declared above
       >>surface  the camera's G-buffer
       >>sensors  frames, views, weights                                                                     */

#include <float.h>
#include <limits.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#ifdef _WIN32
  /* declared here so that windows.h stays out of the host's file */
  #ifdef __cplusplus
  extern "C" {
  #endif
  __declspec(dllimport) int __stdcall QueryPerformanceCounter(void *count);
  __declspec(dllimport) int __stdcall QueryPerformanceFrequency(void *frequency);
  #ifdef __cplusplus
  }
  #endif
#else
  #include <sys/time.h>
#endif
#ifdef SBL_EGL
  #ifndef EGL_NO_X11
    #define EGL_NO_X11  /* keeps Xlib's macros (None, Bool, Status) out of the host's file */
    #define SBL__EGL_NO_X11
  #endif
  #include <EGL/egl.h>
  #include <EGL/eglext.h>
  #ifdef SBL__EGL_NO_X11
    #undef EGL_NO_X11
  #endif
#endif

/* >>shaders: made by scripts/embed_shaders from shaders_embedded, do not edit here */
static const char *const sbl__glsl_belongs[] = {
    "// How far two surface points of one id belong together, 0 to 1: by their normals and by how far each lies off the other's plane.\n",
    "// sbl__belongs in sbl.h is the same for the CPU.\n",
    "float sbl_belongs(vec3 p, vec3 n, vec3 q, vec3 m) {\n",
    "    float turn = clamp((dot(n, m) - 0.8) / 0.2, 0.0, 1.0);\n",
    "    vec3 d = q - p;\n",
    "    float off = max(abs(dot(d, n)), abs(dot(d, m))), apart = length(d);\n",
    "    return turn * turn * clamp(2.0 - 8.0 * off / max(apart, 1e-30), 0.0, 1.0);\n",
    "}\n",
    0 };
static const char *const sbl__glsl_copy[] = {
    "// Reads a host's texture as sampling it gives it: sRGB decoded, swizzled.\n",
    "uniform sampler2D source;\n",
    "layout(location = 0) out vec4 out_color;\n",
    "\n",
    "void main() { out_color = texelFetch(source, ivec2(gl_FragCoord.xy), 0); }\n",
    0 };
static const char *const sbl__glsl_filter[] = {
    "// The Gaussian of section III-H: over pixels of the same id, its weights renormalised to one.\n",
    "// Outside paper mode a pixel also counts the less the more its normal and its plane differ, and its light by more than noise can explain.\n",
    "uniform sampler2D radiance;  // R; a: its noise, above 0 where there is a surface\n",
    "uniform sampler2D positions, normals;\n",
    "uniform usampler2D ids;\n",
    "uniform int radius;\n",
    "uniform float falloff;       // 1 / (2 sigma^2), sigma in pixels\n",
    "uniform int geometry_aware;\n",
    "uniform float tolerance;     // noise that is there in any case, relative\n",
    "layout(location = 0) out vec4 out_radiance;\n",
    "\n",
    "// 1 where noise alone explains the difference, nearing 0 where it is several times as large.\n",
    "float sbl_alike(vec4 a, vec4 b) {\n",
    "    vec3 apart = abs(a.rgb - b.rgb);\n",
    "    float noise = a.a + b.a + tolerance * (max(a.r, max(a.g, a.b)) + max(b.r, max(b.g, b.b)));\n",
    "    float difference = max(apart.r, max(apart.g, apart.b)) / max(noise, 1e-30);\n",
    "    return exp(-0.25 * difference * difference);\n",
    "}\n",
    "\n",
    "void main() {\n",
    "    ivec2 at = ivec2(gl_FragCoord.xy), size = textureSize(radiance, 0);\n",
    "    uint id = texelFetch(ids, at, 0).x;\n",
    "    out_radiance = vec4(0);\n",
    "    if (id == 0u) return;\n",
    "    vec3 p = texelFetch(positions, at, 0).xyz, n = texelFetch(normals, at, 0).xyz;\n",
    "    vec4 sum = vec4(0), own = texelFetch(radiance, at, 0);\n",
    "    for (int y = max(-radius, -at.y); y <= min(radius, size.y - 1 - at.y); y++)\n",
    "        for (int x = max(-radius, -at.x); x <= min(radius, size.x - 1 - at.x); x++) {\n",
    "            ivec2 there = at + ivec2(x, y);\n",
    "            if (texelFetch(ids, there, 0).x != id) continue;\n",
    "            vec4 light = texelFetch(radiance, there, 0);\n",
    "            float weight = exp(-falloff * float(x * x + y * y));\n",
    "            if (geometry_aware != 0 && (x != 0 || y != 0))\n",
    "                weight *= sbl_belongs(p, n, texelFetch(positions, there, 0).xyz, texelFetch(normals, there, 0).xyz) * sbl_alike(own, light);\n",
    "            sum += weight * vec4(light.rgb, 1);\n",
    "        }\n",
    "    out_radiance = vec4(sum.rgb / sum.a, 1);\n",
    "}\n",
    0 };
static const char *const sbl__glsl_fullscreen_vertex[] = {
    "// One triangle that covers the viewport; drawn with three vertices and no buffers.\n",
    "void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0, 1); }\n",
    0 };
static const char *const sbl__glsl_gbuffer_fragment[] = {
    "uniform vec3 origin_0, origin_x, origin_y;           // a pixel's ray, affine in its position\n",
    "uniform vec3 direction_0, direction_x, direction_y;\n",
    "uniform vec2 depth_from_w;                           // depth = x * gl_FragCoord.w + y, where the driver has no clip control\n",
    "uniform float facet_limit;                           // shading normals count from triangles of this least height on, in pixels; fully from twice that on\n",
    "layout(location = 0) out vec4 out_position;\n",
    "layout(location = 1) out vec4 out_normal;\n",
    "layout(location = 2) out vec4 out_geometric_normal;\n",
    "layout(location = 3) out vec4 out_albedo;\n",
    "layout(location = 4) out vec4 out_emission;\n",
    "layout(location = 5) out uint out_id;\n",
    "\n",
    "void main() {\n",
    "    vec2 at = gl_FragCoord.xy;\n",
    "    vec3 origin = origin_0 + at.x * origin_x + at.y * origin_y, direction = direction_0 + at.x * direction_x + at.y * direction_y;\n",
    "    sbl_Surface s = sbl_surface(gl_PrimitiveID, origin, direction);\n",
    "    // Shading normals are there to hide facets; facets that are too small to be seen show the light that the true surface gets.\n",
    "    float pixel = length(origin_y + distance(s.position, origin) / length(direction) * direction_y);\n",
    "    if (facet_limit > 0.0) s.normal = normalize(mix(s.geometric_normal, s.normal, clamp(s.facet / (facet_limit * pixel) - 1.0, 0.0, 1.0)));\n",
    "    if (s.albedo.a == 0.0) discard;\n",
    "    out_position = vec4(s.position, s.reach);\n",
    "    out_normal = vec4(s.normal, 0);\n",
    "    out_geometric_normal = vec4(s.geometric_normal, 0);\n",
    "    out_albedo = vec4(s.albedo.rgb, 1);\n",
    "    out_emission = vec4(s.emission, 0);\n",
    "    out_id = s.id;\n",
    "#ifdef SBL_WRITE_DEPTH\n",
    "    gl_FragDepth = depth_from_w.x > 0.0 ? depth_from_w.x * gl_FragCoord.w : 2.0 * gl_FragCoord.z - 1.0;\n",
    "#endif\n",
    "}\n",
    0 };
static const char *const sbl__glsl_gbuffer_vertex[] = {
    "// The camera's view of the scene. Depth is reversed: 1 at the near end, 0 at infinity.\n",
    "layout(location = 0) in vec3 position;\n",
    "layout(location = 1) in uint object;\n",
    "uniform vec3 eye;\n",
    "uniform vec4 clip_x, clip_y, clip_z, clip_w;  // rows of world to clip, the world taken relative to the eye\n",
    "\n",
    "void main() {\n",
    "    vec4 p = vec4(position - eye, 1);\n",
    "    gl_Position = vec4(dot(clip_x, p), dot(clip_y, p), dot(clip_z, p), dot(clip_w, p));\n",
    "    if ((sbl_object(object, 1).w & SBL_HIDDEN_FROM_CAMERA) != 0u) gl_Position = vec4(2, 2, 2, 1);\n",
    "}\n",
    0 };
static const char *const sbl__glsl_lamps[] = {
    "// Light from lamps: emitting triangles, punctual lights, bright spots of the sky. What each gives where nothing stands between is known in closed form;\n",
    "// rays only measure which share of it arrives: the ratio estimator of Heitz, Hill and McGuire 2018, \"Combining analytic direct illumination and stochastic\n",
    "// shadows\". Where lamps are many, those far off stand together in clusters, of which only single lamps,\n",
    "// picked in proportion to what they give, are ever looked at.\n",
    "// One invocation is one sensor, or a part of its rays where they are many: neighbours trace neighbouring rays, and each stops as soon as it knows enough.\n",
    "uniform usamplerBuffer sbl_points;    // a sensor, three texels: position, turn; normal; first of its directions, of its lamp points, a hash for these, how far it is off its surface\n",
    "uniform usamplerBuffer sbl_sequence;  // see trace.glsl\n",
    "uniform sbl_Texels sbl_lamps;         // see >>lamps in sbl.h: nodes, leaves, lights\n",
    "uniform int lamp_nodes, lamp_leaves;  // how many\n",
    "uniform int rays;                     // at most so many a sensor\n",
    "uniform float unit, scale;            // radiance that calculations are in, so that none overflows; of what is written\n",
    "SBL_OUT(0, out_light);                // R, each part's own; the variance of its channels' mean\n",
    "\n",
    "const float PI = 3.14159265;\n",
    "const uint SBL_TRIANGLE = 0u, SBL_NEAR_LIGHT = 1u, SBL_FAR_LIGHT = 2u, SBL_SKY_TEXEL = 3u;  // a leaf's kind, in its upper two bits\n",
    "const uint SBL_FAR_NODE = 0x80000000u;\n",
    "const int SBL_CERTAIN = 32;      // so many points of light get a ray each\n",
    "const int SBL_PROBES = 12;       // along the rim of a round lamp; of a triangle's, three\n",
    "const float SBL_STRATA = 0.1;    // stratified points have far less variance than independent ones: a tenth is what edges across a lamp leave\n",
    "\n",
    "struct sbl_Lamp {\n",
    "    uint kind;\n",
    "    vec3 emission;             // a triangle's radiance; a light's irradiance of a surface here that faces it; a texel's light, radiance times solid angle\n",
    "    vec3 corner;               // of the triangle, from the sensor; else the unit direction to the light's middle, or to the texel's middle\n",
    "    vec3 side_1, side_2;       // of the triangle\n",
    "    float away, radius, sine2; // of a light: distance, radius, sine squared of the angle that it spans to each side\n",
    "    ivec2 texel;\n",
    "    int triangle, number;      // as traced; in the scene\n",
    "    vec2 group;                // 0 1 for a triangle that turns its back to the sensor, else 1 0\n",
    "};\n",
    "\n",
    "sbl_Lamp sbl_lamp(int leaf, vec3 p, vec3 n) {\n",
    "    uint code = sbl_fetch(sbl_lamps, 4 * lamp_nodes + leaf).x, at = code & 0x3fffffffu;\n",
    "    sbl_Lamp l = sbl_Lamp(code >> 30, vec3(0), vec3(0), vec3(0), vec3(0), 1e30, 0.0, 0.0, ivec2(at & 32767u, at >> 15), int(at), -1, vec2(1, 0));\n",
    "    sbl_when (l.kind == SBL_TRIANGLE) {\n",
    "        uvec4 a = sbl_fetch(sbl_triangles, 3 * l.triangle), b = sbl_fetch(sbl_triangles, 3 * l.triangle + 1), c = sbl_fetch(sbl_triangles, 3 * l.triangle + 2), light = sbl_object(a.w, 1);\n",
    "        l.corner = uintBitsToFloat(a.xyz);\n",
    "        l.side_1 = uintBitsToFloat(b.xyz) - l.corner;\n",
    "        l.side_2 = uintBitsToFloat(c.xyz) - l.corner;\n",
    "        l.corner -= p;\n",
    "        l.emission = uintBitsToFloat(light.rgb) / unit;\n",
    "        l.number = int(b.w);\n",
    "        l.group = dot(cross(l.side_1, l.side_2), l.corner) > 0.0 ? vec2(0, 1) : vec2(1, 0);\n",
    "        if (l.group.y == 1.0 && (light.w & SBL_ONE_SIDED_EMISSION) != 0u) l.emission = vec3(0);\n",
    "    }\n",
    "    sbl_when (l.kind == SBL_SKY_TEXEL) {\n",
    "        vec2 size = vec2(textureSize(sky_picture, 0)), middle = (vec2(l.texel) + 0.5) / size;\n",
    "        vec3 radiance = texelFetch(sky_picture, l.texel, 0).rgb;\n",
    "        l.corner = sbl_sky_direction(middle.x, cos(PI * middle.y));\n",
    "        l.emission = radiance * (sbl_sky_excess(radiance) / unit * (2.0 * PI / size.x) * 2.0 * sin(PI * middle.y) * sin(0.5 * PI / size.y));\n",
    "    }\n",
    "    sbl_when (l.kind == SBL_NEAR_LIGHT || l.kind == SBL_FAR_LIGHT) {\n",
    "        int first = 4 * lamp_nodes + lamp_leaves + 3 * int(at);\n",
    "        vec4 a = uintBitsToFloat(sbl_fetch(sbl_lamps, first)), b = uintBitsToFloat(sbl_fetch(sbl_lamps, first + 1)), c = uintBitsToFloat(sbl_fetch(sbl_lamps, first + 2));\n",
    "        l.corner = a.xyz;\n",
    "        l.emission = b.rgb / unit;\n",
    "        l.sine2 = a.w;\n",
    "        if (l.kind == SBL_NEAR_LIGHT) {\n",
    "            l.corner -= p;\n",
    "            l.radius = a.w;\n",
    "            l.away = length(l.corner);\n",
    "            l.corner /= max(l.away, 1e-30);\n",
    "            float spot = clamp(dot(c.xyz, -l.corner) * b.w + c.w, 0.0, 1.0);  // KHR_lights_punctual\n",
    "            if (l.away < l.radius) { l.corner = n; l.away = l.radius; spot = 1.0; }  // the sensor stands in it\n",
    "            l.emission *= spot * spot / (l.away * l.away);\n",
    "            l.sine2 = min(l.radius * l.radius / (l.away * l.away), 1.0);\n",
    "        }\n",
    "    }\n",
    "    return l;\n",
    "}\n",
    "\n",
    "// An edge's part of Lambert's sum: the angle it spans, times the cosine of its plane's normal to z.\n",
    "float sbl_edge(vec3 p, vec3 q) {\n",
    "    vec3 normal = cross(p, q);\n",
    "    float size = length(normal);\n",
    "    return size > 0.0 ? atan(size, dot(p, q)) * normal.z / size : 0.0;\n",
    "}\n",
    "\n",
    "// Share of a hemisphere around z that a triangle fills, weighted by the cosine: Lambert 1760. Corners relative to the sensor, in its frame.\n",
    "float sbl_form_factor(vec3 a, vec3 b, vec3 c) {\n",
    "    vec3 middle = (a + b + c) / 3.0, normal = cross(b - a, c - a);\n",
    "    float distance2 = dot(middle, middle), size2 = max(dot(b - a, b - a), max(dot(c - a, c - a), dot(c - b, c - b)));\n",
    "    if (min(a.z, min(b.z, c.z)) > 0.0 && distance2 > 1e5 * size2)  // too small for the sum's rounding, small enough for a point\n",
    "        return 0.5 * abs(dot(normal, middle)) * middle.z / (PI * distance2 * distance2);\n",
    "    vec3 corners[3] = vec3[3](a, b, c), entry = vec3(0), leave = vec3(0);\n",
    "    float sum = 0.0;\n",
    "    bool cut = false;\n",
    "    for (int k = 0; k < 3; k++) {  // what is below the horizon does not count\n",
    "        vec3 p = corners[k], q = corners[k == 2 ? 0 : k + 1];\n",
    "        if (max(p.z, q.z) <= 0.0) continue;\n",
    "        if (min(p.z, q.z) <= 0.0) {\n",
    "            vec3 x = vec3(mix(p.xy, q.xy, p.z / (p.z - q.z)), 0);\n",
    "            cut = true;\n",
    "            if (p.z <= 0.0) entry = p = x;\n",
    "            else leave = q = x;\n",
    "        }\n",
    "        sum += sbl_edge(p, q);\n",
    "    }\n",
    "    if (cut) sum += sbl_edge(leave, entry);\n",
    "    return abs(sum) / (2.0 * PI);\n",
    "}\n",
    "\n",
    "// The same for a round lamp whose middle has the cosine z to the normal, over the sine squared of the angle that it spans to each side: Snyder 1996,\n",
    "// \"Area Light Sources for Real-Time Graphics\"; small ones as flat discs.\n",
    "float sbl_round(float z, float sine2) {\n",
    "    float sine = sqrt(sine2), s = sqrt(max(1.0 - z * z, 0.0));\n",
    "    if (z >= sine || z <= -sine) return max(z, 0.0);\n",
    "    float q = z / sine, x = sqrt(1.0 / sine2 - 1.0), y = clamp(-x * z / s, -1.0, 1.0), w = s * sqrt(1.0 - y * y);\n",
    "    if (sine2 < 1e-4) return sine / PI * (q * acos(-q) + sqrt(1.0 - q * q) * (2.0 + q * q) / 3.0);\n",
    "    return (z * acos(y) - x * w + atan(w, x) / sine2) / PI;\n",
    "}\n",
    "\n",
    "// R from a lamp that nothing hides.\n",
    "vec3 sbl_unhindered(sbl_Lamp l, vec3 n, mat3 to_frame) {\n",
    "    float factor = 0.0;\n",
    "    sbl_when (l.kind == SBL_TRIANGLE) {\n",
    "        vec3 corner = to_frame * l.corner;\n",
    "        factor = sbl_form_factor(corner, corner + to_frame * l.side_1, corner + to_frame * l.side_2);\n",
    "    }\n",
    "    sbl_when (l.kind == SBL_NEAR_LIGHT || l.kind == SBL_FAR_LIGHT) factor = sbl_round(dot(n, l.corner), l.sine2) / PI;\n",
    "    sbl_when (l.kind == SBL_SKY_TEXEL) factor = max(dot(n, l.corner) + PI / float(textureSize(sky_picture, 0).y), 0.0) / PI;  // about: above 0 where some of it is above the horizon\n",
    "    return l.emission * factor;\n",
    "}\n",
    "\n",
    "// A subtree: a cluster of lamps.\n",
    "struct sbl_Cluster {\n",
    "    vec3 to;       // its middle, from the sensor\n",
    "    float radius;\n",
    "    bool far;      // directions\n",
    "    int beyond;    // the node after it\n",
    "};\n",
    "\n",
    "sbl_Cluster sbl_cluster(int node, vec3 p) {\n",
    "    vec4 ball = uintBitsToFloat(sbl_fetch(sbl_lamps, 4 * node));\n",
    "    uint skip = sbl_fetch(sbl_lamps, 4 * node + 2).w;\n",
    "    bool far = (skip & SBL_FAR_NODE) != 0u;\n",
    "    return sbl_Cluster(ball.xyz - (far ? vec3(0) : p), ball.w, far, int(skip & ~SBL_FAR_NODE));\n",
    "}\n",
    "\n",
    "// What it gives about: zero only where none of its lamps gives anything.\n",
    "float sbl_strength(int node, sbl_Cluster c, vec3 n) {\n",
    "    vec4 square = uintBitsToFloat(sbl_fetch(sbl_lamps, 4 * node + 1)), cross_terms = uintBitsToFloat(sbl_fetch(sbl_lamps, 4 * node + 2));\n",
    "    vec3 front = uintBitsToFloat(sbl_fetch(sbl_lamps, 4 * node + 3).xyz);\n",
    "    float distance2 = max(dot(c.to, c.to), 1e-37), spread = min(c.radius * inversesqrt(distance2), 1.0), height = dot(n, c.to);\n",
    "    vec3 w = c.far ? -n : c.to * inversesqrt(distance2);  // far lamps turn no sides to the sensor, but are seen under the cosine to its normal\n",
    "    float shown = sqrt(max(dot(square.xyz, w * w) + 2.0 * dot(cross_terms.xyz, w.xyz * w.yzx), 0.0)) - dot(front, w) + 0.1 * square.w * spread;\n",
    "    if (height + c.radius <= 0.0) return 0.0;\n",
    "    return max(shown, 0.0) * (c.far ? 1.0 : max(height, 0.5 * (height + c.radius)) * inversesqrt(distance2) / max(distance2, c.radius * c.radius)) / unit;\n",
    "}\n",
    "\n",
    "// A direction to the spherical triangle of unit vectors a, b, c, evenly distributed: Arvo 1995, \"Stratified Sampling of Spherical Triangles\".\n",
    "// w: its solid angle; 0 where it is too small for that.\n",
    "vec4 sbl_spherical(vec3 a, vec3 b, vec3 c, vec2 u) {\n",
    "    vec3 ab = cross(a, b), bc = cross(b, c), ca = cross(c, a);\n",
    "    float alpha = atan(length(cross(ab, ca)), -dot(ab, ca)), beta = atan(length(cross(bc, ab)), -dot(bc, ab)), gamma = atan(length(cross(ca, bc)), -dot(ca, bc));\n",
    "    float solid_angle = alpha + beta + gamma - PI;\n",
    "    if (!(solid_angle > 0.01)) return vec4(0);\n",
    "    float s = sin(u.x * solid_angle - alpha), t = cos(u.x * solid_angle - alpha), sin_alpha = sin(alpha), cos_alpha = cos(alpha);\n",
    "    float p = t - cos_alpha, v = s + sin_alpha * dot(a, b);\n",
    "    float q = clamp(((v * t - p * s) * cos_alpha - v) / ((v * s + p * t) * sin_alpha), -1.0, 1.0);\n",
    "    vec3 cut = q * a + sqrt(1.0 - q * q) * normalize(c - dot(c, a) * a);\n",
    "    float z = 1.0 - u.y * (1.0 - dot(cut, b));\n",
    "    return vec4(z * b + sqrt(max(1.0 - z * z, 0.0)) * normalize(cut - dot(cut, b) * b), solid_angle);\n",
    "}\n",
    "\n",
    "// A point of a lamp.\n",
    "struct sbl_Sample {\n",
    "    vec3 direction;\n",
    "    float far;    // how far it is\n",
    "    vec3 light;   // R from the lamp, were it all like this point\n",
    "    vec2 b;       // barycentrics on a triangle\n",
    "};\n",
    "\n",
    "sbl_Sample sbl_sample(sbl_Lamp l, vec3 n, vec2 u) {\n",
    "    sbl_Sample s = sbl_Sample(l.corner, 1e30, l.emission / PI, u);\n",
    "    sbl_when (l.kind == SBL_TRIANGLE) {  // by solid angle where it is large, else by area (Heitz 2019, \"A Low-Distortion Map Between Triangle and Square\")\n",
    "        vec3 normal = cross(l.side_1, l.side_2);\n",
    "        vec4 ray = sbl_spherical(normalize(l.corner), normalize(l.corner + l.side_1), normalize(l.corner + l.side_2), u);\n",
    "        s.b = u.y > u.x ? vec2(0.5 * u.x, u.y - 0.5 * u.x) : vec2(u.x - 0.5 * u.y, 0.5 * u.y);\n",
    "        // not so near to an edge that rounding may carry the ray past it\n",
    "        float reach2 = dot(l.corner, l.corner), longest2 = max(dot(l.side_1, l.side_1), dot(l.side_2, l.side_2));\n",
    "        s.b = mix(s.b, vec2(1.0 / 3.0), min(3e-6 * sqrt(longest2) * reach2 / max(abs(dot(normal, l.corner)), 1e-37), 0.5));\n",
    "        vec3 to = l.corner + s.b.x * l.side_1 + s.b.y * l.side_2;\n",
    "        if (ray.w > 0.0) {\n",
    "            to = ray.xyz * dot(l.corner, normal) / dot(ray.xyz, normal);\n",
    "            s.b = vec2(dot(cross(to - l.corner, l.side_2), normal), dot(cross(l.side_1, to - l.corner), normal)) / dot(normal, normal);\n",
    "        }\n",
    "        s.far = length(to);\n",
    "        s.direction = to / s.far;\n",
    "        s.light *= ray.w > 0.0 ? ray.w : 0.5 * abs(dot(normal, s.direction)) / (s.far * s.far);\n",
    "    }\n",
    "    sbl_when (l.kind == SBL_SKY_TEXEL) {\n",
    "        vec2 size = vec2(textureSize(sky_picture, 0));\n",
    "        float row = float(l.texel.y);\n",
    "        s.direction = sbl_sky_direction((float(l.texel.x) + u.x) / size.x, mix(cos(PI * row / size.y), cos(PI * (row + 1.0) / size.y), u.y));\n",
    "    }\n",
    "    sbl_when (l.kind == SBL_NEAR_LIGHT || l.kind == SBL_FAR_LIGHT) {\n",
    "        float cosine = sqrt(1.0 - l.sine2), off = u.x * l.sine2 / (1.0 + cosine), r = sqrt(max(off * (2.0 - off), 0.0));  // off: what the ray's cosine to the middle lacks to 1\n",
    "        s.direction = sbl_frame(l.corner) * vec3(r * cos(2.0 * PI * u.y), r * sin(2.0 * PI * u.y), 1.0 - off);\n",
    "        s.light *= 2.0 / (1.0 + cosine);\n",
    "        if (l.kind == SBL_NEAR_LIGHT) s.far = l.away * (1.0 - off) - sqrt(max(l.radius * l.radius - l.away * l.away * r * r, 0.0));\n",
    "    }\n",
    "    s.light *= max(dot(n, s.direction), 0.0);\n",
    "    return s;\n",
    "}\n",
    "\n",
    "#ifdef SBL_VIEWS  // what the host draws stands in the sensor's own views only\n",
    "uniform sampler2D atlas;        // Ck r g b, signed distance along the view's axis\n",
    "uniform vec4 view_rects[5];     // x, y, width, height in the sheet\n",
    "uniform ivec2 sheet;            // a sensor's, in texels\n",
    "uniform int view_count;\n",
    "uniform float tangent, extent;  // of half a view's width; world units of a distance\n",
    "\n",
    "// A texel shows what stands in its middle, where a lamp's triangle may have ended: such points ask again, nearer to the triangle's middle.\n",
    "bool sbl_hidden(int slot, vec3 n, float turn, sbl_Lamp l, sbl_Sample s) {\n",
    "    mat3 frame = sbl_frame(n);\n",
    "    vec3 axes[2] = vec3[2](cos(turn) * frame[0] - sin(turn) * frame[1], -cos(turn) * frame[1] - sin(turn) * frame[0]);  // right and up, see sbl__frame\n",
    "    vec3 normal = cross(l.side_1, l.side_2), point = s.far * s.direction, middle = l.corner + (l.side_1 + l.side_2) / 3.0;\n",
    "    if (l.kind != SBL_TRIANGLE) point = s.direction;\n",
    "    for (int attempt = 0; attempt < 4; attempt++, point = mix(point, middle, 0.4)) {\n",
    "        vec3 right = axes[0], up = axes[1], forward = n;\n",
    "        vec2 side = vec2(dot(point, right), dot(point, up));\n",
    "        bool top = max(abs(side.x), abs(side.y)) <= dot(point, n) * tangent;\n",
    "        int face = top ? 0 : abs(side.x) > abs(side.y) ? (side.x > 0.0 ? 1 : 3) : (side.y > 0.0 ? 2 : 4);\n",
    "        if (!top && view_count == 1) return true;\n",
    "        if (!top) {\n",
    "            forward = face == 1 ? axes[0] : face == 2 ? axes[1] : face == 3 ? -axes[0] : -axes[1];\n",
    "            right = face == 1 ? axes[1] : face == 2 ? -axes[0] : face == 3 ? -axes[1] : axes[0];\n",
    "            up = n;\n",
    "        }\n",
    "        vec4 rect = view_rects[face];\n",
    "        vec2 lowest = vec2(-1, top ? -1 : 0), size = vec2(1) - lowest, at = (vec2(dot(point, right), dot(point, up)) / (dot(point, forward) * tangent) - lowest) / size;\n",
    "        vec2 texel = clamp(floor(at * rect.zw), vec2(0), rect.zw - 1.0), centre = lowest + (texel + 0.5) / rect.zw * size;\n",
    "        float shown = texelFetch(atlas, ivec2(slot % columns, slot / columns) * sheet + ivec2(rect.xy + texel), 0).a, seen = abs(shown) * extent;\n",
    "        if (seen == 0.0) return false;\n",
    "        if (l.kind != SBL_TRIANGLE) return seen < 0.998 * s.far * dot(point, forward);\n",
    "        vec3 ray = forward + tangent * (centre.x * right + centre.y * up);\n",
    "        float there = dot(l.corner, normal) / dot(ray, normal);  // where it meets the lamp's plane\n",
    "        bool other_side = (shown < 0.0) != (l.group.y == 1.0);  // of a thin body\n",
    "        if (there > 0.0 && (seen > 1.002 * there || (seen >= 0.998 * there && !other_side))) return false;\n",
    "        vec3 hit = there * ray - l.corner;\n",
    "        vec2 b = vec2(dot(cross(hit, l.side_2), normal), dot(cross(l.side_1, hit), normal)) / dot(normal, normal);\n",
    "        if (attempt == 3 || (there > 0.0 && min(b.x, b.y) >= 0.0 && b.x + b.y <= 1.0)) return seen < (other_side ? 1.002 : 0.998) * dot(point, forward);\n",
    "    }\n",
    "    return true;\n",
    "}\n",
    "#endif\n",
    "\n",
    "void main() {\n",
    "    ivec2 at = sbl_texel_of_invocation();\n",
    "    int parts = blocks.y, part = at.y % parts, slot = at.y / parts * columns + at.x, sensor = slot - first_slot;\n",
    "    if (sensor < 0 || sensor >= count) sbl_leave;\n",
    "    uvec4 place = texelFetch(sbl_points, 3 * sensor), words = texelFetch(sbl_points, 3 * sensor + 2);\n",
    "    vec3 stand = uintBitsToFloat(place.xyz), n = uintBitsToFloat(texelFetch(sbl_points, 3 * sensor + 1).xyz);\n",
    "    vec3 position = stand - uintBitsToFloat(words.w) * n;  // on the surface: a lamp close by is seen from there\n",
    "    uvec2 scramble = uvec2(words.z, (words.z ^ words.z >> 15) * 747796405u);\n",
    "    scramble.y ^= scramble.y >> 13;\n",
    "    mat3 to_frame = transpose(sbl_frame(n));\n",
    "\n",
    "    // Which lamps count here: single ones and, where there are many, clusters that are small for their distance.\n",
    "    int entries[SBL_LAMPS];      // a leaf, or -1 - a node; from the end on: points of light, which get a ray each\n",
    "    float strengths[SBL_LAMPS];  // what each gives about, summed up\n",
    "    float total = 0.0, crowd = 0.0, opening = 0.3;  // crowd: the sum of their squares\n",
    "    mat2x3 all = mat2x3(0);      // single lamps, unhindered; two groups, since of a closed mesh one is all hidden, the other all open\n",
    "    int used = 0, certain = 0, limit = lamp_leaves <= SBL_LAMPS ? lamp_leaves : lamp_nodes;\n",
    "    bool full = true, rounded = false;\n",
    "    for (int attempt = 0; attempt < 12 && full; attempt++, opening *= 2.0) {\n",
    "        used = certain = 0;\n",
    "        total = crowd = 0.0;\n",
    "        all = mat2x3(0);\n",
    "        full = false;\n",
    "        for (int i = 0, next; i < limit; i = next) {\n",
    "            int leaf = i;\n",
    "            float strength = 0.0;\n",
    "            bool single = lamp_leaves <= SBL_LAMPS, point = false;\n",
    "            next = i + 1;\n",
    "            sbl_when (!single) {\n",
    "                sbl_Cluster c = sbl_cluster(i, position);\n",
    "                if (dot(n, c.to) + c.radius <= 0.0) next = c.beyond;\n",
    "                else if (c.beyond == i + 1) {\n",
    "                    single = true;\n",
    "                    leaf = int(sbl_fetch(sbl_lamps, 4 * i + 3).w);\n",
    "                } else if (attempt == 11 || c.radius * c.radius < opening * opening * dot(c.to, c.to)) {\n",
    "                    next = c.beyond;\n",
    "                    strength = sbl_strength(i, c, n);\n",
    "                }\n",
    "            }\n",
    "            sbl_when (single) {\n",
    "                sbl_Lamp l = sbl_lamp(leaf, position, n);\n",
    "                vec3 light = sbl_unhindered(l, n, to_frame);\n",
    "                strength = light.r + light.g + light.b;\n",
    "                rounded = rounded || l.kind != SBL_TRIANGLE;\n",
    "                point = l.sine2 == 0.0 && (l.kind == SBL_NEAR_LIGHT || l.kind == SBL_FAR_LIGHT) && certain < SBL_CERTAIN;\n",
    "                if (!point && l.kind != SBL_SKY_TEXEL) all += outerProduct(light, l.group);\n",
    "            }\n",
    "            if (strength > 0.0) {\n",
    "                full = used + certain == SBL_LAMPS;\n",
    "                if (full) next = limit;\n",
    "                else if (point) entries[SBL_LAMPS - ++certain] = leaf;\n",
    "                else {\n",
    "                    total += strength;\n",
    "                    crowd += strength * strength;\n",
    "                    strengths[used] = total;\n",
    "                    entries[used++] = single ? leaf : -1 - i;\n",
    "                }\n",
    "            }\n",
    "        }\n",
    "    }\n",
    "\n",
    "    mat2x3 open = mat2x3(0), seen = open;  // what the samples of single lamps give without and with what stands between\n",
    "    vec3 sure = vec3(0), sampled = vec3(0);  // from points of light; from clusters, summed over the samples\n",
    "    vec2 samples = vec2(0), lit = samples;\n",
    "    float taken = 0.0, squares = 0.0;\n",
    "    // A group that samples hardly meet is no ground for a ratio: it is sampled as clusters are.\n",
    "    float enough = 16.0 * float(parts) / float(rays) * total;\n",
    "    vec2 sparse = vec2(lessThan(vec3(1) * all, vec2(enough)));\n",
    "    // The first eighth, or half of few, tells whether there is more to know: what it overlooks is less than a sample's share. The more lamps there are,\n",
    "    // the more of the samples it takes to know each.\n",
    "    int passes = clamp(min(rays / 32, int(16.0 * crowd / max(total * total, 1e-37))), 1, 8);\n",
    "    passes = passes >= 8 ? 8 : passes >= 4 ? 4 : passes >= 2 ? 2 : 1;\n",
    "    // So that they do not overlook an edge that hides little, corners and rims of few lamps are looked at besides.\n",
    "    int rims = rounded ? SBL_PROBES : 3, probes = passes > 1 && used <= 8 ? rims * used : 0;\n",
    "    vec2 bright = vec2(0), dark = bright;  // whether any of a group was seen, or hidden\n",
    "    bool undecided = total > 0.0;\n",
    "    for (int pass = -1; pass < passes && (pass < 0 || undecided); pass++) {\n",
    "        // each part has a stretch of the sequence, and each eighth of it covers a lamp, and the lamps, evenly\n",
    "        int from = (8 * part + pass * 8 / passes) * rays / (8 * parts), to = total > 0.0 ? (8 * part + (pass + 1) * 8 / passes) * rays / (8 * parts) : from;\n",
    "        for (int k = pass < 0 ? part : pass == 0 ? from - probes : from; k < (pass < 0 ? certain : to); k += pass < 0 ? parts : 1) {\n",
    "            bool probe = pass == 0 && k < from;\n",
    "            uvec2 fraction = texelFetch(sbl_sequence, int(words.y) + max(k, 0)).xy ^ scramble;\n",
    "            vec2 u = (vec2(fraction >> 8) + 0.5) / 16777216.0;\n",
    "            int entry = entries[pass < 0 ? SBL_LAMPS - 1 - k : 0];\n",
    "            float picked = pass < 0 ? 1.0 / float(parts) : 1.0;  // how often the lamp is\n",
    "            if (probe) entry = entries[(from - 1 - k) / rims];\n",
    "            else if (pass >= 0) {  // one in proportion to its strength\n",
    "                float wanted = u.x * total, before = 0.0;\n",
    "                int low = 0, high = used - 1;\n",
    "                while (low < high) {\n",
    "                    int middle = (low + high) / 2;\n",
    "                    if (strengths[middle] < wanted) { low = middle + 1; before = strengths[middle]; }\n",
    "                    else high = middle;\n",
    "                }\n",
    "                float width = strengths[low] - before;\n",
    "                u.x = clamp((wanted - before) / width, 0.0, 1.0);\n",
    "                picked = width / total;\n",
    "                entry = entries[low];\n",
    "            }\n",
    "            if (probe && entry < 0) continue;\n",
    "            bool cluster = entry < 0;\n",
    "            sbl_when (cluster) {  // down to one of its lamps, at every fork in proportion to what the branches give\n",
    "                int node = -1 - entry;\n",
    "                u.x = clamp(u.x + (float(fraction.x & 255u) - 127.5) / 4294967296.0 / picked, 0.0, 1.0);  // digits below those of a float that are left\n",
    "                for (sbl_Cluster c = sbl_cluster(node, position); c.beyond != node + 1; c = sbl_cluster(node, position)) {\n",
    "                    sbl_Cluster left = sbl_cluster(node + 1, position), right = sbl_cluster(left.beyond, position);\n",
    "                    float weight = sbl_strength(node + 1, left, n), share = weight / max(weight + sbl_strength(left.beyond, right, n), 1e-37);\n",
    "                    bool first = u.x < share;\n",
    "                    node = first ? node + 1 : left.beyond;\n",
    "                    picked *= first ? share : 1.0 - share;\n",
    "                    u.x = first ? u.x / share : (u.x - share) / (1.0 - share);\n",
    "                }\n",
    "                entry = int(sbl_fetch(sbl_lamps, 4 * node + 3).w);\n",
    "            }\n",
    "            sbl_Lamp l = sbl_lamp(entry, position, n);\n",
    "            int rim = (from - 1 - k) % rims;\n",
    "            if (probe && (l.kind == SBL_SKY_TEXEL || (l.kind == SBL_TRIANGLE && rim > 2))) continue;\n",
    "            sbl_Sample s = sbl_sample(l, n, probe ? vec2(0.99, (float(rim) + float(scramble.y >> 8) / 16777216.0) / float(SBL_PROBES)) : u);\n",
    "            sbl_when (probe && l.kind == SBL_TRIANGLE) {\n",
    "                vec3 to = l.corner + (rim == 1 ? 0.996 : 0.002) * l.side_1 + (rim == 2 ? 0.996 : 0.002) * l.side_2;\n",
    "                s.far = length(to);\n",
    "                s.direction = to / s.far;\n",
    "                s.light = vec3(dot(to, n));\n",
    "            }\n",
    "            if (l.kind == SBL_SKY_TEXEL || dot(sparse, l.group) > 0.0) cluster = true;\n",
    "            vec3 light = s.light / picked;\n",
    "            taken += pass < 0 || probe ? 0.0 : 1.0;\n",
    "            if (!(light.r + light.g + light.b > 0.0)) continue;\n",
    "            if (!cluster && pass >= 0 && !probe) {\n",
    "                open += outerProduct(light, l.group);\n",
    "                samples += l.group;\n",
    "            }\n",
    "            vec3 to = s.direction;\n",
    "            if (s.far < 1e30) to = s.far * s.direction + (position - stand);\n",
    "            float away = s.far < 1e30 ? length(to) : 1.0;\n",
    "            sbl_Hit hit = sbl_trace(stand, to / away, s.far < 1e30 ? away * 0.99999 : 1e30);\n",
    "            bool hidden = hit.triangle >= 0 && hit.number != l.number;\n",
    "#ifdef SBL_VIEWS\n",
    "            hidden = hidden || sbl_hidden(slot, n, uintBitsToFloat(place.w), l, s);\n",
    "#endif\n",
    "            if (pass >= 0 && (probe || !cluster)) {\n",
    "                if (hidden) dark += l.group;\n",
    "                else bright += l.group;\n",
    "            }\n",
    "            if (hidden || probe) continue;\n",
    "#ifdef SBL_TEXTURED\n",
    "            sbl_when (l.kind == SBL_TRIANGLE) {\n",
    "                sbl_Attributes at = sbl_attributes_at(l.triangle, s.b.x, s.b.y);\n",
    "                light *= sbl_texture(sbl_object(sbl_fetch(sbl_triangles, 3 * l.triangle).w, 3), at.uv).rgb;\n",
    "            }\n",
    "#endif\n",
    "            if (pass < 0) sure += light;\n",
    "            else if (cluster) {\n",
    "                sampled += light;\n",
    "                float mean = dot(light, vec3(1.0 / 3.0));\n",
    "                squares += mean * mean;\n",
    "            } else {\n",
    "                seen += outerProduct(light, l.group);\n",
    "                lit += l.group;\n",
    "            }\n",
    "        }\n",
    "        // all is open, or nothing: the first samples tell; so do clusters that are alike\n",
    "        float mean = dot(sampled, vec3(1.0 / 3.0)) / max(taken, 1.0), error = (squares / max(taken, 1.0) - mean * mean) / max(taken, 1.0);\n",
    "        bool mixed = dot(bright, dark) > 0.0 || (seen[0] != vec3(0) && seen[0] != open[0]) || (seen[1] != vec3(0) && seen[1] != open[1]);\n",
    "        if (pass >= 0) undecided = mixed || SBL_STRATA * error > 1e-6 * mean * mean;\n",
    "    }\n",
    "    float clusters = dot(sampled, vec3(1.0 / 3.0)) / max(taken, 1.0), variance = max(squares / max(taken, 1.0) - clusters * clusters, 0.0) / max(taken, 1.0);\n",
    "    vec3 light = sure + sampled / max(taken, 1.0);\n",
    "    for (int g = 0; g < 2; g++) {\n",
    "        vec3 share = vec3(open[g].r > 0.0 ? seen[g].r / open[g].r : 0.0, open[g].g > 0.0 ? seen[g].g / open[g].g : 0.0, open[g].b > 0.0 ? seen[g].b / open[g].b : 0.0);\n",
    "        float mean = dot(all[g], vec3(1.0 / 3.0)), lit_share = lit[g] / max(samples[g], 1.0);\n",
    "        if (sparse[g] > 0.0) continue;\n",
    "        light += all[g] * share;\n",
    "        variance += mean * mean * lit_share * (1.0 - lit_share) / max(samples[g], 1.0);\n",
    "    }\n",
    "    sbl_write(out_light, vec4(light, SBL_STRATA * variance * unit * scale) * unit * scale);\n",
    "}\n",
    0 };
static const char *const sbl__glsl_reduce_blocks[] = {
    "// First half of a sensor's sum: every output texel adds up one block of the atlas.\n",
    "uniform sampler2D atlas;    // Ck r g b, signed distance\n",
    "uniform sampler2D weights;  // of one sheet: the texel's projected solid angle over pi, its ray's length at unit distance\n",
    "uniform int block;          // texels across a block\n",
    "uniform ivec2 blocks;       // of one sheet\n",
    "layout(location = 0) out vec4 out_sum;   // sum of weight * Ck; weight that sees back faces\n",
    "layout(location = 1) out vec4 out_hits;  // weight that sees surfaces; weight * distance; nearest distance; 0\n",
    "\n",
    "void main() {\n",
    "    ivec2 at = ivec2(gl_FragCoord.xy), corner = at * block, sheet_corner = (at % blocks) * block;\n",
    "    vec4 sum = vec4(0), hits = vec4(0, 0, 1e30, 0);\n",
    "    for (int y = 0; y < block; y++) {\n",
    "        vec3 row = vec3(0);\n",
    "        float back = 0.0;\n",
    "        for (int x = 0; x < block; x++) {\n",
    "            vec4 texel = texelFetch(atlas, corner + ivec2(x, y), 0);\n",
    "            vec2 weight = texelFetch(weights, sheet_corner + ivec2(x, y), 0).xy;\n",
    "            row += weight.x * texel.rgb;\n",
    "            float seen = weight.x > 0.0 && texel.a != 0.0 ? weight.x : 0.0;\n",
    "            float length_to_hit = abs(texel.a) * weight.y;\n",
    "            back += texel.a < 0.0 ? seen : 0.0;\n",
    "            hits.x += seen;\n",
    "            hits.y += seen * min(length_to_hit, 1e30);\n",
    "            hits.z = seen > 0.0 ? min(hits.z, length_to_hit) : hits.z;\n",
    "        }\n",
    "        sum += vec4(row, back);\n",
    "    }\n",
    "    out_sum = sum;\n",
    "    out_hits = hits;\n",
    "}\n",
    0 };
static const char *const sbl__glsl_reduce_sum[] = {
    "// Second half: every output texel adds up the blocks of one sensor and is its result.\n",
    "uniform sampler2D block_sums, block_hits;\n",
    "uniform ivec2 blocks;  // of one sheet\n",
    "uniform int columns;   // sheets across the atlas\n",
    "uniform int slots;     // sheets in the atlas\n",
    "uniform int width;     // of the results' texture\n",
    "uniform int first, last;\n",
    "uniform sampler2D lights;  // parts texels a sensor, one below the other, whose mean comes on top: light; its variance\n",
    "uniform int parts;         // 0: there are none\n",
    "layout(location = 0) out vec4 out_sum;\n",
    "layout(location = 1) out vec4 out_hits;  // w: the variance of the light's mean over the channels, where rays sampled it\n",
    "\n",
    "void main() {\n",
    "    int sensor = int(gl_FragCoord.y) * width + int(gl_FragCoord.x);\n",
    "    if (sensor < first || sensor > last) discard;\n",
    "    int slot = sensor % slots;\n",
    "    ivec2 corner = ivec2(slot % columns, slot / columns) * blocks;\n",
    "    vec4 sum = vec4(0), hits = vec4(0, 0, 1e30, 0);\n",
    "    for (int y = 0; y < blocks.y; y++) {\n",
    "        vec4 row = vec4(0), row_hits = vec4(0);\n",
    "        for (int x = 0; x < blocks.x; x++) {\n",
    "            row += texelFetch(block_sums, corner + ivec2(x, y), 0);\n",
    "            vec4 h = texelFetch(block_hits, corner + ivec2(x, y), 0);\n",
    "            row_hits += h;\n",
    "            hits.z = min(hits.z, h.z);\n",
    "        }\n",
    "        sum += row;\n",
    "        hits.xyw += row_hits.xyw;\n",
    "    }\n",
    "    // where rays were traced, blocks are independent estimates of a share each, and w sums their squares\n",
    "    float n = float(blocks.x * blocks.y), mean = dot(sum.rgb, vec3(1.0 / 3.0));\n",
    "    hits.w = n > 1.0 ? max((hits.w - mean * mean / n) * n / (n - 1.0), 0.0) : 0.0;\n",
    "    for (int i = 0; i < parts; i++) {\n",
    "        vec4 light = texelFetch(lights, ivec2(slot % columns, slot / columns * parts + i), 0) / float(parts);\n",
    "        sum.rgb += light.rgb;\n",
    "        hits.w += light.a / float(parts);\n",
    "    }\n",
    "    out_sum = sum;\n",
    "    out_hits = hits;\n",
    "}\n",
    0 };
static const char *const sbl__glsl_resolve[] = {
    "// Composition (section III-H) of one anti-aliasing sample of every pixel: emission + albedo * R. The sample has its own G-buffer;\n",
    "// R is looked up among the nearest pixel centres that show the same surface, so that light never bleeds over an edge.\n",
    "uniform sampler2D radiance;                 // R at pixel centres\n",
    "uniform sampler2D positions, normals;       // at pixel centres\n",
    "uniform usampler2D ids;\n",
    "uniform sampler2D sample_positions, sample_normals, sample_albedo, sample_emission;\n",
    "uniform usampler2D sample_ids;\n",
    "uniform vec2 offset;                        // of the sample from the pixel's centre, pixels\n",
    "uniform vec3 sky;                         // constant\n",
    "uniform vec3 direction_0, direction_x, direction_y;  // a pixel's ray, affine in its position\n",
    "uniform sampler2D previous;                 // what the samples before this one gave\n",
    "uniform float first, share;               // first: 0 for the first sample, else 1; share: 1 / samples\n",
    "layout(location = 0) out vec4 out_color;\n",
    "\n",
    "// As a camera sees the environment: bilinear.\n",
    "vec3 sbl_sky_smooth(vec3 direction) {\n",
    "    vec3 radiance = vec3(0);\n",
    "    if (sky_limit == 0.0) return radiance;\n",
    "    ivec2 size = textureSize(sky_picture, 0);\n",
    "    vec2 at = sbl_sky_at(direction) * vec2(size) - 0.5, corner = floor(at), f = at - corner;\n",
    "    for (int i = 0; i < 4; i++) {\n",
    "        ivec2 step = ivec2(i & 1, i >> 1), texel = ivec2(corner) + step;\n",
    "        vec2 weight = mix(1.0 - f, f, vec2(step));\n",
    "        radiance += weight.x * weight.y * texelFetch(sky_picture, ivec2((texel.x + size.x) % size.x, clamp(texel.y, 0, size.y - 1)), 0).rgb;\n",
    "    }\n",
    "    return radiance;\n",
    "}\n",
    "\n",
    "void main() {\n",
    "    ivec2 at = ivec2(gl_FragCoord.xy), size = textureSize(radiance, 0);\n",
    "    uint id = texelFetch(sample_ids, at, 0).x;\n",
    "    vec4 before = first == 0.0 ? vec4(0) : texelFetch(previous, at, 0);\n",
    "    if (id == 0u) { out_color = before + share * vec4(sky + sbl_sky_smooth(direction_0 + gl_FragCoord.x * direction_x + gl_FragCoord.y * direction_y), 1); return; }\n",
    "    vec3 p = texelFetch(sample_positions, at, 0).xyz, n = texelFetch(sample_normals, at, 0).xyz;\n",
    "    vec3 light = vec3(0);\n",
    "    if (offset == vec2(0)) light = texelFetch(radiance, at, 0).rgb;\n",
    "    else {\n",
    "        vec4 near = vec4(0), far = vec4(0), rest = vec4(0);\n",
    "        for (int y = -2; y <= 2; y++)\n",
    "            for (int x = -2; x <= 2; x++) {\n",
    "                ivec2 there = clamp(at + ivec2(x, y), ivec2(0), size - 1);\n",
    "                uint there_id = texelFetch(ids, there, 0).x;\n",
    "                if (there_id == 0u) continue;\n",
    "                vec3 q = texelFetch(positions, there, 0).xyz, m = texelFetch(normals, there, 0).xyz;\n",
    "                vec4 r = vec4(texelFetch(radiance, there, 0).rgb, 1);\n",
    "                vec2 d = abs(vec2(x, y) - offset);\n",
    "                float tent = max(0.0, 1.0 - d.x) * max(0.0, 1.0 - d.y), reach = exp(-dot(d, d));\n",
    "                float belongs = there_id == id ? sbl_belongs(p, n, q, m) : 0.0;\n",
    "                near += r * tent * belongs;\n",
    "                far += r * reach * (belongs + (there_id == id ? 1e-3 : 0.0));\n",
    "                rest += r * reach * (0.01 + max(0.0, dot(n, m)));\n",
    "            }\n",
    "        if (near.a > 0.05) light = near.rgb / near.a;\n",
    "        else if (far.a > 0.0) light = far.rgb / far.a;\n",
    "        else if (rest.a > 0.0) light = rest.rgb / rest.a;\n",
    "    }\n",
    "    out_color = before + share * vec4(texelFetch(sample_emission, at, 0).rgb + texelFetch(sample_albedo, at, 0).rgb * light, 1);\n",
    "}\n",
    0 };
static const char *const sbl__glsl_scene[] = {
    "// The scene as a shader sees it: triangles, objects and texels, all read by number.\n",
    "// One object record per mesh (see sbl__object_record in sbl.h):\n",
    "//   0  albedo r g b, alpha cutoff      floats as bits\n",
    "//   1  emission r g b                  floats as bits;  flags\n",
    "//   2  albedo texture:   first row in the texel store, width, height, kind (0 none, 1 8-bit sRGB, 2 16-bit float, +4 clamps)\n",
    "//   3  emission texture: likewise\n",
    "//   4  id, 0, 0, 0\n",
    "#ifdef SBL_WIDE  // what grows with the scene is past the driver's limit for buffer textures, and stands in 2D ones (see sbl__texels_make)\n",
    "#define sbl_Texels usampler2D\n",
    "#define sbl_fetch(texels, i) texelFetch(texels, ivec2((i) & 4095, (i) >> 12), 0)\n",
    "#else\n",
    "#define sbl_Texels usamplerBuffer\n",
    "#define sbl_fetch(texels, i) texelFetch(texels, i)\n",
    "#endif\n",
    "\n",
    "uniform sbl_Texels sbl_objects;\n",
    "uniform sampler2D sbl_texels_srgb;   // all 8-bit sRGB textures, each starting on a row of its own, texel n of a texture at n % width, n / width\n",
    "uniform sampler2D sbl_texels_float;  // all others\n",
    "\n",
    "const int SBL_OBJECT_TEXELS = 5;\n",
    "const uint SBL_ONE_SIDED_EMISSION = 1u;\n",
    "const uint SBL_HIDDEN_FROM_CAMERA = 2u;\n",
    "const uint SBL_HIDDEN_FROM_SENSORS = 4u;\n",
    "\n",
    "uvec4 sbl_object(uint object, int field) { return sbl_fetch(sbl_objects, int(object) * SBL_OBJECT_TEXELS + field); }\n",
    "\n",
    "vec4 sbl_texel(uvec4 texture_record, ivec2 at) {\n",
    "    ivec2 size = ivec2(texture_record.yz);\n",
    "    at = (texture_record.w & 4u) != 0u ? clamp(at, ivec2(0), size - 1) : at - size * ivec2(floor(vec2(at) / vec2(size)));\n",
    "    at = clamp(at, ivec2(0), size - 1);  // the division above may round up for far repeats\n",
    "    int index = at.y * size.x + at.x;\n",
    "    if ((texture_record.w & 3u) == 1u) {\n",
    "        int width = textureSize(sbl_texels_srgb, 0).x;\n",
    "        return texelFetch(sbl_texels_srgb, ivec2(index % width, int(texture_record.x) + index / width), 0);\n",
    "    }\n",
    "    int width = textureSize(sbl_texels_float, 0).x;\n",
    "    return texelFetch(sbl_texels_float, ivec2(index % width, int(texture_record.x) + index / width), 0);\n",
    "}\n",
    "\n",
    "// Bilinear, decoded before it is filtered; (0, 0) is the first texel's outer corner.\n",
    "vec4 sbl_texture(uvec4 texture_record, vec2 uv) {\n",
    "    if (texture_record.w == 0u) return vec4(1);\n",
    "    if ((texture_record.w & 4u) == 0u) uv -= floor(uv);\n",
    "    vec2 at = uv * vec2(texture_record.yz) - 0.5, corner = floor(at), f = at - corner;\n",
    "    ivec2 c = ivec2(clamp(corner, vec2(-1e9), vec2(1e9)));\n",
    "    return mix(mix(sbl_texel(texture_record, c), sbl_texel(texture_record, c + ivec2(1, 0)), f.x),\n",
    "               mix(sbl_texel(texture_record, c + ivec2(0, 1)), sbl_texel(texture_record, c + ivec2(1, 1)), f.x), f.y);\n",
    "}\n",
    0 };
static const char *const sbl__glsl_sensor_fragment[] = {
    "// What a sensor's texel holds: Ck, and the distance along the view axis, negative where a back face is seen.\n",
    "layout(location = 0) out vec4 out_radiance;\n",
    "#ifdef SBL_TEXTURED\n",
    "uniform float epsilon, radiance_scale;\n",
    "uniform bool lamps_apart;  // light from emitting triangles comes from lamps.glsl\n",
    "flat in uint fragment_object;\n",
    "in vec2 fragment_uv;\n",
    "in vec4 fragment_color;\n",
    "#else\n",
    "flat in vec3 radiance_front, radiance_back;\n",
    "#endif\n",
    "#ifdef SBL_WRITE_DEPTH\n",
    "uniform float depth_scale;\n",
    "#endif\n",
    "\n",
    "void main() {\n",
    "#ifdef SBL_TEXTURED\n",
    "    uvec4 material = sbl_object(fragment_object, 0), light = sbl_object(fragment_object, 1);\n",
    "    vec3 emission = uintBitsToFloat(light.rgb);\n",
    "    bool emits = max(max(emission.r, emission.g), emission.b) > 0.0;\n",
    "    if (emits && !gl_FrontFacing && (light.w & SBL_ONE_SIDED_EMISSION) != 0u) emits = false;\n",
    "    vec3 radiance = vec3(0);\n",
    "    float cutoff = uintBitsToFloat(material.w);\n",
    "    if (cutoff > 0.0 || (!emits && epsilon > 0.0)) {\n",
    "        vec4 albedo = fragment_color * sbl_texture(sbl_object(fragment_object, 2), fragment_uv);\n",
    "        if (albedo.a < cutoff) discard;\n",
    "        radiance = epsilon * uintBitsToFloat(material.rgb) * albedo.rgb;\n",
    "    }\n",
    "    if (emits && lamps_apart) radiance = vec3(0);\n",
    "    else if (emits) radiance = emission * sbl_texture(sbl_object(fragment_object, 3), fragment_uv).rgb;\n",
    "    radiance *= radiance_scale;\n",
    "#else\n",
    "    vec3 radiance = gl_FrontFacing ? radiance_front : radiance_back;\n",
    "#endif\n",
    "    out_radiance = vec4(radiance, gl_FrontFacing ? 1.0 / gl_FragCoord.w : -1.0 / gl_FragCoord.w);\n",
    "#ifdef SBL_WRITE_DEPTH\n",
    "    gl_FragDepth = depth_scale * gl_FragCoord.w;\n",
    "#endif\n",
    "}\n",
    0 };
static const char *const sbl__glsl_sensor_vertex[] = {
    "// Draws the scene into many sensors' views at once: an instance is one view, cut to its rectangle of the atlas by four planes.\n",
    "layout(location = 0) in vec3 position;\n",
    "layout(location = 1) in uint object;\n",
    "layout(location = 4) in vec3 view_eye;\n",
    "layout(location = 5) in vec4 view_right;    // right over half the view's width at unit distance;  scale of x in the atlas\n",
    "layout(location = 6) in vec4 view_up;       // up over half its height;                            scale of y\n",
    "layout(location = 7) in vec4 view_forward;  // forward;                                            lowest y: -1, or 0 where the horizon cuts the view\n",
    "layout(location = 8) in vec2 view_offset;   // of the rectangle in the atlas\n",
    "uniform float per_length;                   // 1 / extent of the scene\n",
    "uniform float depth_scale;                  // depth is depth_scale / distance: reversed, without a far plane\n",
    "#ifdef SBL_TEXTURED\n",
    "layout(location = 2) in vec2 vertex_uv;\n",
    "layout(location = 3) in vec4 vertex_color;\n",
    "flat out uint fragment_object;\n",
    "out vec2 fragment_uv;\n",
    "out vec4 fragment_color;\n",
    "#else\n",
    "uniform float epsilon, radiance_scale;\n",
    "uniform bool lamps_apart;                   // light from emitting triangles comes from lamps.glsl\n",
    "flat out vec3 radiance_front, radiance_back;\n",
    "#endif\n",
    "\n",
    "void main() {\n",
    "    uvec4 light = sbl_object(object, 1);\n",
    "#ifdef SBL_TEXTURED\n",
    "    fragment_object = object;\n",
    "    fragment_uv = vertex_uv;\n",
    "    fragment_color = vertex_color;\n",
    "#else\n",
    "    // Ck of equations 1 and 2: a light's radiance, or the ambient factor times the colour\n",
    "    vec3 emission = uintBitsToFloat(light.rgb);\n",
    "    vec3 ambient = epsilon * uintBitsToFloat(sbl_object(object, 0).rgb);\n",
    "    radiance_front = radiance_scale * (max(max(emission.r, emission.g), emission.b) > 0.0 ? lamps_apart ? vec3(0) : emission : ambient);\n",
    "    radiance_back = (light.w & SBL_ONE_SIDED_EMISSION) != 0u ? radiance_scale * ambient : radiance_front;\n",
    "#endif\n",
    "    vec3 p = (position - view_eye) * per_length;\n",
    "    float x = dot(view_right.xyz, p), y = dot(view_up.xyz, p), w = dot(view_forward.xyz, p);\n",
    "    gl_Position = vec4(x * view_right.w + w * view_offset.x, y * view_up.w + w * view_offset.y, depth_scale, w);\n",
    "    gl_ClipDistance[0] = w + x;\n",
    "    gl_ClipDistance[1] = w - x;\n",
    "    gl_ClipDistance[2] = y - w * view_forward.w;\n",
    "    gl_ClipDistance[3] = w - y;\n",
    "    if ((light.w & SBL_HIDDEN_FROM_SENSORS) != 0u) gl_ClipDistance[0] = -1.0;\n",
    "}\n",
    0 };
static const char *const sbl__glsl_sky[] = {
    "// The environment's picture, equirectangular: light from where nothing is hit, besides the constant sky (see sbl_environment).\n",
    "uniform sampler2D sky_picture;\n",
    "uniform vec3 sky_x, sky_up, sky_z;  // its axes in the world\n",
    "uniform float sky_limit;            // radiance from which on it is left to lamps.glsl; 0: there is no picture\n",
    "\n",
    "// Where a direction meets the picture, in its widths and heights.\n",
    "vec2 sbl_sky_at(vec3 direction) {\n",
    "    vec3 d = vec3(dot(direction, sky_x), dot(direction, sky_up), dot(direction, sky_z)) / length(direction);\n",
    "    return vec2(0.5 + (d.x == 0.0 && d.z == 0.0 ? 0.0 : atan(d.z, d.x) / 6.283185307), acos(clamp(d.y, -1.0, 1.0)) / 3.14159265);\n",
    "}\n",
    "\n",
    "// The way back; z: the cosine to sky_up.\n",
    "vec3 sbl_sky_direction(float across, float z) {\n",
    "    float angle = 6.283185307 * (across - 0.5), r = sqrt(max(1.0 - z * z, 0.0));\n",
    "    return r * cos(angle) * sky_x + z * sky_up + r * sin(angle) * sky_z;\n",
    "}\n",
    "\n",
    "// What of a texel's light lamps.glsl samples.\n",
    "float sbl_sky_excess(vec3 radiance) { return max(1.0 - sky_limit / max(max(radiance.r, radiance.g), max(radiance.b, 1e-37)), 0.0); }\n",
    "\n",
    "// The rest of it.\n",
    "vec3 sbl_sky(vec3 direction) {\n",
    "    vec3 radiance = vec3(0);\n",
    "    for (int once = 0; once < (sky_limit > 0.0 ? 1 : 0); once++) {  // a loop, see sbl_trace\n",
    "        ivec2 size = textureSize(sky_picture, 0);\n",
    "        radiance = texelFetch(sky_picture, min(ivec2(sbl_sky_at(direction) * vec2(size)), size - 1), 0).rgb;\n",
    "        radiance *= 1.0 - sbl_sky_excess(radiance);\n",
    "    }\n",
    "    return radiance;\n",
    "}\n",
    0 };
static const char *const sbl__glsl_sky_fragment[] = {
    "in vec3 direction;\n",
    "uniform vec3 sky;  // constant\n",
    "uniform float radiance_scale;\n",
    "layout(location = 0) out vec4 out_radiance;  // as in sensor_fragment.glsl; nothing is hit\n",
    "\n",
    "void main() { out_radiance = vec4(radiance_scale * (sky + sbl_sky(direction)), 0); }\n",
    0 };
static const char *const sbl__glsl_sky_vertex[] = {
    "// The environment behind all that a sensor's view sees: a rectangle for every view, see sensor_vertex.glsl.\n",
    "layout(location = 5) in vec4 view_right;\n",
    "layout(location = 6) in vec4 view_up;\n",
    "layout(location = 7) in vec4 view_forward;\n",
    "layout(location = 8) in vec2 view_offset;\n",
    "out vec3 direction;\n",
    "\n",
    "void main() {\n",
    "    float x = gl_VertexID % 2 == 0 ? -1.0 : 1.0, y = gl_VertexID < 2 ? view_forward.w : 1.0;\n",
    "    direction = view_forward.xyz + x / dot(view_right.xyz, view_right.xyz) * view_right.xyz + y / dot(view_up.xyz, view_up.xyz) * view_up.xyz;\n",
    "    gl_Position = vec4(x * view_right.w + view_offset.x, y * view_up.w + view_offset.y, 0, 1);\n",
    "}\n",
    0 };
static const char *const sbl__glsl_surface[] = {
    "// From a triangle's number and a ray to the surface point. Exact where rasterised attributes are not: a point interpolated across a\n",
    "// large clipped triangle strays off its plane, and a sensor standing there would see its own surface.\n",
    "uniform sbl_Texels sbl_positions;   // a vertex: x y z as float bits, object\n",
    "uniform sbl_Texels sbl_attributes;  // a vertex, two texels: normal x y z, u | v, colour r g (16 bits each), colour b a, 0\n",
    "uniform sbl_Texels sbl_indices;     // three a triangle\n",
    "\n",
    "struct sbl_Surface {\n",
    "    vec3 position, normal, geometric_normal;  // normals point against the ray\n",
    "    vec4 albedo;                              // a: 0 where the cutout leaves nothing\n",
    "    vec3 emission;\n",
    "    float facet;                              // the triangle's least height\n",
    "    float reach;                              // of its corners from the origin, plus its longest side: what rounding is relative to\n",
    "    uint id, flags;\n",
    "};\n",
    "\n",
    "sbl_Surface sbl_surface(int triangle, vec3 origin, vec3 direction) {\n",
    "    ivec3 v = ivec3(int(sbl_fetch(sbl_indices, 3 * triangle).x), int(sbl_fetch(sbl_indices, 3 * triangle + 1).x),\n",
    "                    int(sbl_fetch(sbl_indices, 3 * triangle + 2).x));\n",
    "    uvec4 record = sbl_fetch(sbl_positions, v.x);\n",
    "    vec3 p0 = uintBitsToFloat(record.xyz);\n",
    "    vec3 e1 = uintBitsToFloat(sbl_fetch(sbl_positions, v.y).xyz) - p0;\n",
    "    vec3 e2 = uintBitsToFloat(sbl_fetch(sbl_positions, v.z).xyz) - p0;\n",
    "\n",
    "    // Barycentrics of the ray's hit by Cramer's rule (Moeller and Trumbore 1997), kept inside the triangle.\n",
    "    // The cross product is scaled to the edges' size first, so that small triangles do not underflow.\n",
    "    float size = max(max(max(abs(e1.x), abs(e1.y)), abs(e1.z)), max(max(abs(e2.x), abs(e2.y)), abs(e2.z)));\n",
    "    vec3 s1 = e1 / size, s2 = e2 / size;\n",
    "    vec3 t = (origin - p0) / size, q = cross(t, s1), h = cross(direction, s2);\n",
    "    float determinant = dot(s1, h);\n",
    "    float b1 = clamp(dot(t, h) / determinant, 0.0, 1.0);\n",
    "    float b2 = clamp(dot(direction, q) / determinant, 0.0, 1.0 - b1);\n",
    "    if (!(abs(determinant) > 0.0)) { b1 = 1.0 / 3.0; b2 = 1.0 / 3.0; }\n",
    "    float b0 = 1.0 - b1 - b2;\n",
    "\n",
    "    sbl_Surface s;\n",
    "    s.position = p0 + (b1 * e1 + b2 * e2);\n",
    "    vec3 across = cross(s1, s2), face = normalize(across), s3 = s2 - s1;\n",
    "    float longest = sqrt(max(dot(s1, s1), max(dot(s2, s2), dot(s3, s3))));\n",
    "    s.facet = size * length(across) / longest;\n",
    "    s.reach = length(p0) + 2.0 * size * longest;\n",
    "    bool back = dot(face, direction) > 0.0;\n",
    "    s.geometric_normal = back ? -face : face;\n",
    "\n",
    "    uvec4 n0 = sbl_fetch(sbl_attributes, 2 * v.x), n1 = sbl_fetch(sbl_attributes, 2 * v.y), n2 = sbl_fetch(sbl_attributes, 2 * v.z);\n",
    "    uvec4 c0 = sbl_fetch(sbl_attributes, 2 * v.x + 1), c1 = sbl_fetch(sbl_attributes, 2 * v.y + 1), c2 = sbl_fetch(sbl_attributes, 2 * v.z + 1);\n",
    "    vec3 normal = b0 * uintBitsToFloat(n0.xyz) + b1 * uintBitsToFloat(n1.xyz) + b2 * uintBitsToFloat(n2.xyz);\n",
    "    float length2 = dot(normal, normal);\n",
    "    normal = length2 > 1e-12 ? normal * inversesqrt(length2) : face;\n",
    "    normal = dot(normal, s.geometric_normal) < 0.0 ? -normal : normal;\n",
    "    // A shading normal that turns away from the viewer would aim the sensor at the surface itself: bend it back to grazing.\n",
    "    float grazing = dot(normal, normalize(direction));\n",
    "    if (grazing > -0.01) normal = normalize(normal - (grazing + 0.01) * normalize(direction));\n",
    "    s.normal = normal;\n",
    "\n",
    "    vec2 uv = b0 * uintBitsToFloat(uvec2(n0.w, c0.x)) + b1 * uintBitsToFloat(uvec2(n1.w, c1.x)) + b2 * uintBitsToFloat(uvec2(n2.w, c2.x));\n",
    "    vec4 color = b0 * vec4(c0.y & 65535u, c0.y >> 16, c0.z & 65535u, c0.z >> 16) +\n",
    "                 b1 * vec4(c1.y & 65535u, c1.y >> 16, c1.z & 65535u, c1.z >> 16) +\n",
    "                 b2 * vec4(c2.y & 65535u, c2.y >> 16, c2.z & 65535u, c2.z >> 16);\n",
    "\n",
    "    uvec4 material = sbl_object(record.w, 0), light = sbl_object(record.w, 1);\n",
    "    s.albedo = color / 65535.0 * sbl_texture(sbl_object(record.w, 2), uv);\n",
    "    s.albedo = vec4(s.albedo.rgb * uintBitsToFloat(material.rgb), s.albedo.a < uintBitsToFloat(material.w) ? 0.0 : 1.0);\n",
    "    s.emission = uintBitsToFloat(light.rgb) * sbl_texture(sbl_object(record.w, 3), uv).rgb;\n",
    "    if (back && (light.w & SBL_ONE_SIDED_EMISSION) != 0u) s.emission = vec3(0);\n",
    "    s.id = sbl_object(record.w, 4).x;\n",
    "    s.flags = light.w;\n",
    "    return s;\n",
    "}\n",
    0 };
static const char *const sbl__glsl_trace[] = {
    "// A part of one sensor's rays: cosine-distributed directions, so that all weigh the same. The outputs are those of reduce_blocks.glsl.\n",
    "uniform usamplerBuffer sbl_points;    // a sensor, three texels: position, hash; normal, hash; first ray\n",
    "uniform usamplerBuffer sbl_sequence;  // points of the Sobol sequence, two 32-bit fractions each, along a Morton curve\n",
    "uniform int rays;                     // of a sensor\n",
    "uniform float epsilon;\n",
    "uniform float spread;                 // 1: the cosine's whole hemisphere; 0: all rays go along the normal\n",
    "uniform vec3 sky;\n",
    "uniform bool lamps_apart;             // light from emitting triangles comes from lamps.glsl\n",
    "SBL_OUT(0, out_sum);\n",
    "SBL_OUT(1, out_hits);\n",
    "\n",
    "vec3 sbl_radiance(sbl_Hit hit) {\n",
    "    uint object = sbl_fetch(sbl_triangles, 3 * hit.triangle).w;\n",
    "    uvec4 material = sbl_object(object, 0), light = sbl_object(object, 1);\n",
    "    vec3 emission = uintBitsToFloat(light.rgb);\n",
    "    bool emits = max(max(emission.r, emission.g), emission.b) > 0.0 && !(hit.back && (light.w & SBL_ONE_SIDED_EMISSION) != 0u);\n",
    "    if (emits && lamps_apart) return vec3(0);\n",
    "    vec3 ambient = epsilon * uintBitsToFloat(material.rgb);\n",
    "#ifdef SBL_TEXTURED\n",
    "    sbl_when (emits || epsilon > 0.0) {\n",
    "        sbl_Attributes at = sbl_attributes_at(hit.triangle, hit.b1, hit.b2);\n",
    "        ambient *= (at.color * sbl_texture(sbl_object(object, 2), at.uv)).rgb;\n",
    "        emission *= sbl_texture(sbl_object(object, 3), at.uv).rgb;\n",
    "    }\n",
    "#endif\n",
    "    return emits ? emission : ambient;\n",
    "}\n",
    "\n",
    "void main() {\n",
    "    ivec2 at = sbl_texel_of_invocation(), sheet = at / blocks, within = at % blocks;\n",
    "    int sensor = sheet.y * columns + sheet.x - first_slot;\n",
    "    if (sensor < 0 || sensor >= count) sbl_leave;\n",
    "    uvec4 a = texelFetch(sbl_points, 3 * sensor), b = texelFetch(sbl_points, 3 * sensor + 1);\n",
    "    int skip = int(texelFetch(sbl_points, 3 * sensor + 2).x);\n",
    "    vec3 position = uintBitsToFloat(a.xyz), n = uintBitsToFloat(b.xyz);\n",
    "    mat3 frame = sbl_frame(n);\n",
    "\n",
    "    vec4 sum = vec4(0), hits = vec4(0, 0, 1e30, 0);\n",
    "    for (int i = within.y * blocks.x + within.x; i < rays; i += blocks.x * blocks.y) {\n",
    "        uvec2 fraction = texelFetch(sbl_sequence, skip + i).xy ^ uvec2(a.w, b.w);\n",
    "        vec2 u = (vec2(fraction >> 8) + 0.5) / 16777216.0 * vec2(spread, 1.0);\n",
    "        float radius = sqrt(u.x), angle = 6.283185307 * u.y;\n",
    "        vec3 direction = frame * vec3(radius * cos(angle), radius * sin(angle), sqrt(1.0 - u.x));\n",
    "        sbl_Hit hit = sbl_trace(position, direction, 1e30);\n",
    "        if (hit.triangle < 0) sum.rgb += sky + sbl_sky(direction);\n",
    "        else {\n",
    "            sum += vec4(sbl_radiance(hit), hit.back ? 1.0 : 0.0);\n",
    "            hits.xy += vec2(1.0, hit.distance);\n",
    "            hits.z = min(hits.z, hit.distance);\n",
    "        }\n",
    "    }\n",
    "    sum /= float(rays);\n",
    "    float light = dot(sum.rgb, vec3(1.0 / 3.0));\n",
    "    sbl_write(out_sum, sum);\n",
    "    sbl_write(out_hits, vec4(hits.xy / float(rays), hits.z, light * light));\n",
    "}\n",
    0 };
static const char *const sbl__glsl_traverse[] = {
    "// A ray through the bounding volume hierarchy (see >>bvh in sbl.h). Two texels a node, one a child:\n",
    "//   lowest x | highest x << 16, lowest y | highest y << 16, lowest z | highest z << 16, child\n",
    "// in steps of a grid. A child is a node's number, or 8 + triangles - 1 << 28 | first triangle, or SBL_ENTER << 28 | number of a finer grid in a node's place:\n",
    "//   origin, its root; steps per length, the grid around it\n",
    "// A triangle is three texels: corner, object; corner, number in the scene; corner, 1 where a cutout may leave nothing.\n",
    "uniform sbl_Texels sbl_nodes, sbl_triangles;\n",
    "uniform vec3 grid_origin, grid_per_length;  // of the grid over all, which comes first\n",
    "uniform int node_count;                     // 0: an empty scene\n",
    "\n",
    "// What sensors' programs have in common. A sensor has a block of texels, one an invocation. There are two carriers: fragment shaders drawn over the blocks,\n",
    "// and compute shaders, in which the invocations of a sensor follow each other.\n",
    "// Software renderers run both sides of every if, but leave loops that no lane enters: an if for what is long and rare.\n",
    "#define sbl_when(condition) for (int sbl_once = 0; sbl_once < ((condition) ? 1 : 0); sbl_once++)\n",
    "uniform ivec2 blocks;                 // invocations of a sensor: four by some, so that those that run side by side trace neighbouring rays\n",
    "uniform int columns;                  // sensors across the target\n",
    "uniform int first_slot, count;        // this many sensors stand from first_slot on\n",
    "#ifdef SBL_COMPUTE\n",
    "layout(local_size_x = 64) in;\n",
    "#define SBL_OUT(place, name) layout(rgba32f, binding = place) writeonly uniform image2D name\n",
    "#define sbl_write(name, value) imageStore(name, sbl_texel_of_invocation(), value)\n",
    "#define sbl_leave return\n",
    "\n",
    "ivec2 sbl_texel_of_invocation() {\n",
    "    int i = int(gl_GlobalInvocationID.x), size = blocks.x * blocks.y, slot = first_slot + i / size, part = i % size;\n",
    "    return ivec2(slot % columns, slot / columns) * blocks + ivec2(part % blocks.x, part / blocks.x);\n",
    "}\n",
    "#else\n",
    "#define SBL_OUT(place, name) layout(location = place) out vec4 name\n",
    "#define sbl_write(name, value) name = value\n",
    "#define sbl_leave discard\n",
    "\n",
    "ivec2 sbl_texel_of_invocation() { return ivec2(gl_FragCoord.xy); }\n",
    "#endif\n",
    "\n",
    "#ifdef SBL_TEXTURED\n",
    "struct sbl_Attributes { vec2 uv; vec4 color; };\n",
    "\n",
    "sbl_Attributes sbl_attributes_at(int triangle, float b1, float b2) {\n",
    "    int number = int(sbl_fetch(sbl_triangles, 3 * triangle + 1).w);\n",
    "    vec3 b = vec3(1.0 - b1 - b2, b1, b2);\n",
    "    sbl_Attributes at = sbl_Attributes(vec2(0), vec4(0));\n",
    "    for (int k = 0; k < 3; k++) {\n",
    "        int v = int(sbl_fetch(sbl_indices, 3 * number + k).x);\n",
    "        uint u = sbl_fetch(sbl_attributes, 2 * v).w;\n",
    "        uvec4 c = sbl_fetch(sbl_attributes, 2 * v + 1);\n",
    "        at.uv += b[k] * uintBitsToFloat(uvec2(u, c.x));\n",
    "        at.color += b[k] / 65535.0 * vec4(c.y & 65535u, c.y >> 16, c.z & 65535u, c.z >> 16);\n",
    "    }\n",
    "    return at;\n",
    "}\n",
    "\n",
    "// Is the cutout solid here?\n",
    "bool sbl_solid(int triangle, float b1, float b2) {\n",
    "    uint object = sbl_fetch(sbl_triangles, 3 * triangle).w;\n",
    "    float cutoff = uintBitsToFloat(sbl_object(object, 0).w);\n",
    "    sbl_Attributes at = sbl_attributes_at(triangle, b1, b2);\n",
    "    return at.color.a * sbl_texture(sbl_object(object, 2), at.uv).a >= cutoff;\n",
    "}\n",
    "#endif\n",
    "\n",
    "const uint SBL_LEAF = 0x80000000u, SBL_ENTER = 12u, SBL_LEAVE = 13u, SBL_END = 0xffffffffu;\n",
    "\n",
    "struct sbl_Hit {\n",
    "    float distance;   // in lengths of the direction\n",
    "    int triangle;     // as sbl_triangles counts; negative: nothing was hit\n",
    "    int number;       // of the triangle in the scene\n",
    "    float b1, b2;     // barycentrics of the second and third corner\n",
    "    bool back;\n",
    "};\n",
    "\n",
    "// Does the ray's stretch up to `nearest` cross the box? Its entry distance, or 0x7fffffff; distances are the bits of floats, since they order as integers\n",
    "// where none is negative, and a negative one is below all others. `per` is the length of a grid step along the ray, `offset` brings the origin to 0.\n",
    "int sbl_box(uvec4 box, vec3 per, vec3 offset, bvec3 flip, int nearest) {\n",
    "    vec3 low = vec3(box.xyz & 65535u), high = vec3(box.xyz >> 16);\n",
    "    ivec3 entry = floatBitsToInt(mix(low, high, flip) * per + offset), leave = floatBitsToInt(mix(high, low, flip) * per + offset);\n",
    "    int from = max(max(entry.x, entry.y), max(entry.z, 0)), to = min(min(leave.x, leave.y), min(leave.z, nearest));\n",
    "    return from <= to + 8 ? from : 0x7fffffff;  // units in the last place, see Ize 2013, \"Robust BVH Ray Traversal\"\n",
    "}\n",
    "\n",
    "// The nearest hit nearer than `limit` and farther than `after`, or as far and of a triangle numbered above `past`: hits are ordered by distance, then number.\n",
    "sbl_Hit sbl_nearest(vec3 origin, vec3 direction, float after, int past, float limit) {\n",
    "    sbl_Hit hit = sbl_Hit(limit, -1, -1, 0.0, 0.0, false);\n",
    "\n",
    "    // Watertight against shared edges: Woop, Benthin and Wald 2013. The axis along which the direction is longest becomes z, the ray is sheared onto it.\n",
    "    vec3 size = abs(direction);\n",
    "    int axis = size.x > size.y ? (size.x > size.z ? 0 : 2) : (size.y > size.z ? 1 : 2);\n",
    "    vec3 d = axis == 0 ? direction.yzx : axis == 1 ? direction.zxy : direction;\n",
    "    float shear_x = d.x / d.z, shear_y = d.y / d.z, per_z = 1.0 / d.z;\n",
    "\n",
    "    bvec3 flip = lessThan(direction, vec3(0));\n",
    "    vec3 inverse = 1.0 / mix(max(direction, vec3(1e-12)), min(direction, vec3(-1e-12)), flip);\n",
    "    vec3 per = inverse / grid_per_length, offset = (grid_origin - origin) * inverse;\n",
    "    uint stack[SBL_STACK];\n",
    "    stack[0] = SBL_END;\n",
    "    int top = 0;\n",
    "    uint node = node_count == 0 ? SBL_END : 1u;\n",
    "    while (true) {\n",
    "        while (node < SBL_LEAF) {  // down to a leaf, the nearer child first\n",
    "            uvec4 first = sbl_fetch(sbl_nodes, int(node) * 2), second = sbl_fetch(sbl_nodes, int(node) * 2 + 1);\n",
    "            int nearest = floatBitsToInt(hit.distance), a = sbl_box(first, per, offset, flip, nearest), b = sbl_box(second, per, offset, flip, nearest);\n",
    "            node = a <= b ? first.w : second.w;\n",
    "            if (max(a, b) < 0x7fffffff) stack[++top] = a <= b ? second.w : first.w;\n",
    "            if (min(a, b) == 0x7fffffff) node = stack[top--];\n",
    "        }\n",
    "        bool leaf = true;\n",
    "        while ((node & 0xe0000000u) == SBL_ENTER << 28 && leaf) {  // into a grid, or back to the one around it; a loop, see sbl_trace\n",
    "            uvec4 first = sbl_fetch(sbl_nodes, int(node & 0x0fffffffu) * 2), second = sbl_fetch(sbl_nodes, int(node & 0x0fffffffu) * 2 + 1);\n",
    "            per = inverse / uintBitsToFloat(second.xyz);\n",
    "            offset = (uintBitsToFloat(first.xyz) - origin) * inverse;\n",
    "            if (node >> 28 == SBL_ENTER) {\n",
    "                stack[++top] = SBL_LEAVE << 28 | second.w;\n",
    "                node = first.w;\n",
    "            } else node = stack[top--];\n",
    "            leaf = false;\n",
    "        }\n",
    "        if (!leaf) continue;\n",
    "        if (node == SBL_END) break;\n",
    "        int from = int(node & 0x0fffffffu), to = from + int(node >> 28 & 7u);\n",
    "        for (int t = from; t <= to; t++) {\n",
    "            uvec4 second = sbl_fetch(sbl_triangles, 3 * t + 1);\n",
    "            vec3 p = uintBitsToFloat(sbl_fetch(sbl_triangles, 3 * t).xyz) - origin;\n",
    "            vec3 q = uintBitsToFloat(second.xyz) - origin;\n",
    "            vec3 r = uintBitsToFloat(sbl_fetch(sbl_triangles, 3 * t + 2).xyz) - origin;\n",
    "            p = axis == 0 ? p.yzx : axis == 1 ? p.zxy : p;\n",
    "            q = axis == 0 ? q.yzx : axis == 1 ? q.zxy : q;\n",
    "            r = axis == 0 ? r.yzx : axis == 1 ? r.zxy : r;\n",
    "            p.xy -= vec2(shear_x, shear_y) * p.z;\n",
    "            q.xy -= vec2(shear_x, shear_y) * q.z;\n",
    "            r.xy -= vec2(shear_x, shear_y) * r.z;\n",
    "            float u = r.x * q.y - r.y * q.x, v = p.x * r.y - p.y * r.x, w = q.x * p.y - q.y * p.x, determinant = u + v + w;\n",
    "            bool inside = ((u >= 0.0 && v >= 0.0 && w >= 0.0) || (u <= 0.0 && v <= 0.0 && w <= 0.0)) && determinant != 0.0;\n",
    "            float l = (u * p.z + v * q.z + w * r.z) * per_z / determinant;\n",
    "            // A triangle that the ray starts beside, its own above all, must not be hit by rounding: it grows with how thin the triangle is.\n",
    "            float deep = max(abs(p.z), max(abs(q.z), abs(r.z))), wide = max(dot(p.xy, p.xy), max(dot(q.xy, q.xy), dot(r.xy, r.xy)));\n",
    "            inside = inside && l > 1e-4 * deep || inside && l * abs(determinant) > 1.2e-7 * deep * wide;\n",
    "            int number = int(second.w);\n",
    "            bool behind = l > after || (l == after && number > past);\n",
    "            if (inside && behind && (l < hit.distance || (l == hit.distance && number < hit.number)))\n",
    "                hit = sbl_Hit(l, t, number, v / determinant, w / determinant, (determinant < 0.0) == (d.z > 0.0));\n",
    "        }\n",
    "        node = stack[top--];\n",
    "    }\n",
    "    return hit;\n",
    "}\n",
    "\n",
    "// The nearest hit nearer than `limit`.\n",
    "sbl_Hit sbl_trace(vec3 origin, vec3 direction, float limit) {\n",
    "    sbl_Hit hit = sbl_Hit(0.0, -1, 0x7fffffff, 0.0, 0.0, false);\n",
    "#ifdef SBL_TEXTURED\n",
    "    // Cutouts: the nearest hit is looked at, and where nothing is there the ray goes on behind it.\n",
    "    // All ifs are loops, since software renderers run both sides of every if, but leave loops that no lane enters.\n",
    "    for (int layer = 0; layer < 64; layer++) {\n",
    "        bool solid = true;\n",
    "        hit = sbl_nearest(origin, direction, hit.distance, hit.number, limit);\n",
    "        for (uint cut = hit.triangle < 0 ? 0u : sbl_fetch(sbl_triangles, 3 * hit.triangle + 2).w; cut != 0u; cut = 0u) solid = sbl_solid(hit.triangle, hit.b1, hit.b2);\n",
    "        if (solid) break;\n",
    "    }\n",
    "#else\n",
    "    hit = sbl_nearest(origin, direction, hit.distance, hit.number, limit);\n",
    "#endif\n",
    "    return hit;\n",
    "}\n",
    "\n",
    "// Right, up and forward of a sensor that looks along n: Duff et al. 2017, \"Building an Orthonormal Basis, Revisited\".\n",
    "mat3 sbl_frame(vec3 n) {\n",
    "    float s = n.z < 0.0 ? -1.0 : 1.0, f = -1.0 / (s + n.z), g = n.x * n.y * f;\n",
    "    return mat3(1.0 + s * n.x * n.x * f, s * g, -s * n.x, g, s + n.y * n.y * f, -n.y, n);\n",
    "}\n",
    0 };
/* <<shaders */

/* ======================================================================================================== >>base
   Config, log, memory, math. */

#define SBL__CANARY_OK(desc) ((desc)->start_canary == 0 && (desc)->end_canary == 0)
#define SBL__COUNT(array) ((int)(sizeof(array) / sizeof((array)[0])))

static double sbl__now(void) {
#ifdef _WIN32
    int64_t count, frequency;
    QueryPerformanceCounter(&count);
    QueryPerformanceFrequency(&frequency);
    return (double)count / (double)frequency;
#else
    struct timeval t;
    gettimeofday(&t, NULL);
    return (double)t.tv_sec + 1e-6 * (double)t.tv_usec;
#endif
}

typedef struct sbl__base {  /* what every room needs of the context */
    sbl_allocator allocator;
    sbl_logger logger;
    sbl_memory memory;
} sbl__base;

static void sbl__log(const sbl__base *base, sbl_log_level level, sbl_log_item item, const char *format, ...) {
    char text[512];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    if (base->logger.log) base->logger.log(level, item, text, base->logger.user);
}

static void sbl__default_log(sbl_log_level level, sbl_log_item item, const char *message, void *user) {
    (void)item; (void)user;
#ifndef SBL_NO_STDIO
    if (level <= SBL_LOG_WARNING) fprintf(stderr, "sbl: %s: %s\n", level == SBL_LOG_ERROR ? "error" : "warning", message);
#else
    (void)level; (void)message;
#endif
}

static void *sbl__default_alloc(size_t bytes, void *user) { (void)user; return malloc(bytes); }
static void sbl__default_free(void *pointer, void *user) { (void)user; free(pointer); }

#define SBL__ALLOC_PREFIX 16  /* holds the size; keeps malloc's alignment */

/* count * size bytes, zeroed; NULL (logged) on overflow or out of memory. A count of 0 gives a pointer all the same. */
static void *sbl__alloc(sbl__base *base, size_t count, size_t size) {
    char *block = NULL;
    size_t bytes = count * size;
    if (size == 0 || count <= (SIZE_MAX - SBL__ALLOC_PREFIX) / size)
        block = (char *)base->allocator.alloc(bytes + SBL__ALLOC_PREFIX, base->allocator.user);
    if (!block) {
        sbl__log(base, SBL_LOG_ERROR, SBL_LOG_ITEM_OUT_OF_MEMORY, "out of memory: %.0f bytes of host memory were refused; use a smaller scene or picture",
                 (double)count * (double)size);
        return NULL;
    }
    memcpy(block, &bytes, sizeof bytes);
    memset(block + SBL__ALLOC_PREFIX, 0, bytes);
    base->memory.host_bytes += bytes;
    if (base->memory.host_bytes > base->memory.host_peak_bytes) base->memory.host_peak_bytes = base->memory.host_bytes;
    return block + SBL__ALLOC_PREFIX;
}

static void sbl__free(sbl__base *base, void *pointer) {
    size_t bytes;
    if (!pointer) return;
    memcpy(&bytes, (char *)pointer - SBL__ALLOC_PREFIX, sizeof bytes);
    base->memory.host_bytes -= bytes;
    base->allocator.free((char *)pointer - SBL__ALLOC_PREFIX, base->allocator.user);
}

#define SBL__PI 3.14159265358979323846
#define SBL__MIN(a, b) ((a) < (b) ? (a) : (b))
#define SBL__MAX(a, b) ((a) > (b) ? (a) : (b))

static int sbl__finite(float x) { return x - x == 0.0f; }

static int sbl__all_finite(const float *x, int count) {
    int i;
    for (i = 0; i < count; i++) if (!sbl__finite(x[i])) return 0;
    return 1;
}

static int sbl__all_zero(const float *x, int count) {
    int i;
    for (i = 0; i < count; i++) if (x[i] != 0.0f) return 0;
    return 1;
}

static float sbl__dot(const float a[3], const float b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
static float sbl__max3(const float a[3]) { return SBL__MAX(a[0], SBL__MAX(a[1], a[2])); }

/* 0 where the vector is too short to have a direction */
static int sbl__normalize(double v[3]) {
    double length = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    if (!(length > 0.0) || !(length < DBL_MAX)) return 0;
    v[0] /= length; v[1] /= length; v[2] /= length;
    return 1;
}

static void sbl__multiply(float out[16], const float a[16], const float b[16]) {
    int column, row, k;
    for (column = 0; column < 4; column++)
        for (row = 0; row < 4; row++) {
            double sum = 0;
            for (k = 0; k < 4; k++) sum += (double)a[4 * k + row] * (double)b[4 * column + k];
            out[4 * column + row] = (float)sum;
        }
}

static void sbl__identity(float m[16]) {
    int i;
    for (i = 0; i < 16; i++) m[i] = i % 5 == 0 ? 1.0f : 0.0f;
}

/* PCG hash (Jarzynski and Olano 2020, "Hash Functions for GPU Rendering") */
static uint32_t sbl__hash(uint32_t x) {
    uint32_t word;
    x = x * 747796405u + 2891336453u;
    word = ((x >> ((x >> 28) + 4u)) ^ x) * 277803737u;
    return (word >> 22) ^ word;
}

/* 16-bit float, rounded to nearest even; too large values become the largest */
static uint16_t sbl__to_half(float value) {
    uint32_t bits, sign, mantissa, rest, half;
    int exponent, shift;
    memcpy(&bits, &value, sizeof bits);
    sign = (bits >> 16) & 0x8000u;
    exponent = (int)((bits >> 23) & 255u) - 127;
    mantissa = (bits & 0x7fffffu) | 0x800000u;
    if (exponent > 15) return (uint16_t)(sign | 0x7bffu);
    if (exponent < -25) return (uint16_t)sign;
    shift = exponent < -14 ? -1 - exponent : 13;
    half = exponent < -14 ? mantissa >> shift : (uint32_t)(exponent + 14) * 1024u + (mantissa >> 13);
    rest = mantissa & ((1u << shift) - 1u);
    if (rest > (1u << (shift - 1)) || (rest == (1u << (shift - 1)) && (half & 1u))) half++;
    return (uint16_t)(sign | SBL__MIN(half, 0x7bffu));
}

static float sbl__from_half(uint16_t half) {
    int exponent = (half >> 10) & 31, mantissa = half & 1023;
    float value = exponent == 31 ? (mantissa ? (float)NAN : (float)HUGE_VAL)
                : exponent ? (float)ldexp((double)(mantissa + 1024), exponent - 25) : (float)ldexp((double)mantissa, -24);
    return half & 0x8000 ? -value : value;
}

static float sbl__srgb_to_linear(float x) { return x <= 0.04045f ? x / 12.92f : (float)pow((x + 0.055) / 1.055, 2.4); }
static float sbl__linear_to_srgb(float x) { return x <= 0.0031308f ? 12.92f * x : (float)(1.055 * pow(x, 1 / 2.4) - 0.055); }

/* ======================================================================================================== >>gl
   Loader, state guard, objects. All GL calls of the pipeline go through the function table of the context. */

#ifdef _WIN32
  #define SBL__GLAPI __stdcall
#else
  #define SBL__GLAPI
#endif

#define SBL__GL_FUNCTIONS(X)                                                                                              \
    X(void, ActiveTexture, (unsigned unit))                                                                               \
    X(void, AttachShader, (unsigned program, unsigned shader))                                                            \
    X(void, BindBuffer, (unsigned target, unsigned buffer))                                                               \
    X(void, BindFramebuffer, (unsigned target, unsigned framebuffer))                                                     \
    X(void, BindSampler, (unsigned unit, unsigned sampler))                                                               \
    X(void, BindTexture, (unsigned target, unsigned texture))                                                             \
    X(void, BindVertexArray, (unsigned array))                                                                            \
    X(void, BufferData, (unsigned target, ptrdiff_t size, const void *data, unsigned usage))                              \
    X(void, BufferSubData, (unsigned target, ptrdiff_t offset, ptrdiff_t size, const void *data))                         \
    X(unsigned, CheckFramebufferStatus, (unsigned target))                                                                \
    X(void, ClampColor, (unsigned target, unsigned clamp))                                                                \
    X(void, ClearBufferfv, (unsigned buffer, int index, const float *value))                                              \
    X(void, ClearBufferuiv, (unsigned buffer, int index, const unsigned *value))                                          \
    X(void, ColorMaski, (unsigned index, unsigned char r, unsigned char g, unsigned char b, unsigned char a))             \
    X(void, CompileShader, (unsigned shader))                                                                             \
    X(unsigned, CreateProgram, (void))                                                                                    \
    X(unsigned, CreateShader, (unsigned type))                                                                            \
    X(void, DeleteBuffers, (int count, const unsigned *names))                                                            \
    X(void, DeleteFramebuffers, (int count, const unsigned *names))                                                       \
    X(void, DeleteProgram, (unsigned program))                                                                            \
    X(void, DeleteSamplers, (int count, const unsigned *names))                                                           \
    X(void, DeleteShader, (unsigned shader))                                                                              \
    X(void, DeleteTextures, (int count, const unsigned *names))                                                           \
    X(void, DeleteVertexArrays, (int count, const unsigned *names))                                                       \
    X(void, DepthFunc, (unsigned function))                                                                               \
    X(void, DepthMask, (unsigned char on))                                                                                \
    X(void, DepthRange, (double nearest, double farthest))                                                                \
    X(void, Disable, (unsigned capability))                                                                               \
    X(void, Disablei, (unsigned capability, unsigned index))                                                              \
    X(void, DrawArrays, (unsigned mode, int first, int count))                                                            \
    X(void, DrawBuffers, (int count, const unsigned *buffers))                                                            \
    X(void, DrawElements, (unsigned mode, int count, unsigned type, const void *offset))                                  \
    X(void, DrawArraysInstanced, (unsigned mode, int first, int count, int instances))                                    \
    X(void, DrawElementsInstanced, (unsigned mode, int count, unsigned type, const void *offset, int instances))          \
    X(void, Enable, (unsigned capability))                                                                                \
    X(void, Enablei, (unsigned capability, unsigned index))                                                               \
    X(void, EnableVertexAttribArray, (unsigned index))                                                                    \
    X(void, Finish, (void))                                                                                               \
    X(void, Flush, (void))                                                                                                \
    X(void, FrontFace, (unsigned direction))                                                                              \
    X(void, FramebufferTexture2D, (unsigned target, unsigned attachment, unsigned kind, unsigned texture, int level))     \
    X(void, GenBuffers, (int count, unsigned *names))                                                                     \
    X(void, GenFramebuffers, (int count, unsigned *names))                                                                \
    X(void, GenSamplers, (int count, unsigned *names))                                                                    \
    X(void, GenTextures, (int count, unsigned *names))                                                                    \
    X(void, GenVertexArrays, (int count, unsigned *names))                                                                \
    X(void, GetBooleani_v, (unsigned name, unsigned index, unsigned char *out))                                           \
    X(void, GetBooleanv, (unsigned name, unsigned char *out))                                                             \
    X(void, GetBufferParameteri64v, (unsigned target, unsigned name, int64_t *out))                                       \
    X(void, GetBufferSubData, (unsigned target, ptrdiff_t offset, ptrdiff_t size, void *data))                            \
    X(void, GetDoublev, (unsigned name, double *out))                                                                     \
    X(unsigned, GetError, (void))                                                                                         \
    X(void, GetIntegerv, (unsigned name, int *out))                                                                       \
    X(void, GetProgramInfoLog, (unsigned program, int room, int *length, char *text))                                     \
    X(void, GetProgramiv, (unsigned program, unsigned name, int *out))                                                    \
    X(void, GetShaderInfoLog, (unsigned shader, int room, int *length, char *text))                                       \
    X(void, GetShaderiv, (unsigned shader, unsigned name, int *out))                                                      \
    X(const unsigned char *, GetString, (unsigned name))                                                                  \
    X(const unsigned char *, GetStringi, (unsigned name, unsigned index))                                                 \
    X(void, GetTexLevelParameteriv, (unsigned target, int level, unsigned name, int *out))                                \
    X(int, GetUniformLocation, (unsigned program, const char *name))                                                      \
    X(unsigned char, IsBuffer, (unsigned name))                                                                           \
    X(unsigned char, IsEnabled, (unsigned capability))                                                                    \
    X(unsigned char, IsEnabledi, (unsigned capability, unsigned index))                                                   \
    X(unsigned char, IsTexture, (unsigned name))                                                                          \
    X(void, LinkProgram, (unsigned program))                                                                              \
    X(void, PixelStorei, (unsigned name, int value))                                                                      \
    X(void, PolygonMode, (unsigned face, unsigned mode))                                                                  \
    X(void, ReadBuffer, (unsigned buffer))                                                                                \
    X(void, ReadPixels, (int x, int y, int width, int height, unsigned format, unsigned type, void *pixels))              \
    X(void, SamplerParameteri, (unsigned sampler, unsigned name, int value))                                              \
    X(void, Scissor, (int x, int y, int width, int height))                                                               \
    X(void, ShaderSource, (unsigned shader, int count, const char *const *strings, const int *lengths))                   \
    X(void, TexBuffer, (unsigned target, unsigned format, unsigned buffer))                                               \
    X(void, TexImage2D, (unsigned target, int level, int internal_format, int width, int height, int border, unsigned format, unsigned type, const void *pixels)) \
    X(void, TexParameteri, (unsigned target, unsigned name, int value))                                                   \
    X(void, TexSubImage2D, (unsigned target, int level, int x, int y, int width, int height, unsigned format, unsigned type, const void *pixels)) \
    X(void, Uniform1f, (int location, float x))                                                                           \
    X(void, Uniform1i, (int location, int x))                                                                             \
    X(void, Uniform2f, (int location, float x, float y))                                                                  \
    X(void, Uniform2i, (int location, int x, int y))                                                                      \
    X(void, Uniform3f, (int location, float x, float y, float z))                                                         \
    X(void, Uniform4f, (int location, float x, float y, float z, float w))                                                \
    X(void, UseProgram, (unsigned program))                                                                               \
    X(void, VertexAttribDivisor, (unsigned index, unsigned divisor))                                                      \
    X(void, VertexAttribIPointer, (unsigned index, int size, unsigned type, int stride, const void *offset))              \
    X(void, VertexAttribPointer, (unsigned index, int size, unsigned type, unsigned char normalized, int stride, const void *offset)) \
    X(void, Viewport, (int x, int y, int width, int height))

/* used where present; missing is no error */
#define SBL__GL_OPTIONAL_FUNCTIONS(X)                        \
    X(void, BindImageTexture, (unsigned unit, unsigned texture, int level, unsigned char layered, int layer, unsigned access, unsigned format)) \
    X(void, ClipControl, (unsigned origin, unsigned depth))  \
    X(void, DepthRangeIndexed, (unsigned index, double nearest, double farthest)) \
    X(void, DispatchCompute, (unsigned x, unsigned y, unsigned z)) \
    X(void, GetDoublei_v, (unsigned name, unsigned index, double *out)) \
    X(void, GetFloati_v, (unsigned name, unsigned index, float *out)) \
    X(void, GetIntegeri_v, (unsigned name, unsigned index, int *out)) \
    X(void, MemoryBarrier, (unsigned what)) \
    X(void, ScissorIndexedv, (unsigned index, const int *box)) \
    X(void, ViewportIndexedfv, (unsigned index, const float *box))

#define SBL__GUARD_UNITS 13
#define SBL__GUARD_DRAW_BUFFERS 8
#define SBL__GUARD_VIEWPORTS 16
#define SBL__GUARD_IMAGES 2

typedef struct sbl__gl {
    sbl__base *base;
#define SBL__X(type, name, parameters) type (SBL__GLAPI *name) parameters;
    SBL__GL_FUNCTIONS(SBL__X)
    SBL__GL_OPTIONAL_FUNCTIONS(SBL__X)
#undef SBL__X
    sbl_capabilities capabilities;
    int viewports;  /* of the viewport array (GL 4.1); 1 without */
} sbl__gl;

enum {
    SBL__GL_NO_ERROR = 0, SBL__GL_OUT_OF_MEMORY = 0x0505,
    SBL__GL_TRIANGLES = 0x0004, SBL__GL_TRIANGLE_STRIP = 0x0005, SBL__GL_ALWAYS = 0x0207, SBL__GL_GREATER = 0x0204,
    SBL__GL_FRONT_AND_BACK = 0x0408, SBL__GL_POLYGON_MODE = 0x0B40, SBL__GL_FILL = 0x1B02, SBL__GL_CULL_FACE = 0x0B44,
    SBL__GL_FRONT_FACE = 0x0B46, SBL__GL_CW = 0x0900, SBL__GL_CCW = 0x0901,
    SBL__GL_DEPTH_RANGE = 0x0B70, SBL__GL_DEPTH_TEST = 0x0B71, SBL__GL_DEPTH_WRITEMASK = 0x0B72, SBL__GL_DEPTH_FUNC = 0x0B74,
    SBL__GL_STENCIL_TEST = 0x0B90, SBL__GL_VIEWPORT = 0x0BA2, SBL__GL_BLEND = 0x0BE2, SBL__GL_COLOR_LOGIC_OP = 0x0BF2,
    SBL__GL_SCISSOR_BOX = 0x0C10, SBL__GL_SCISSOR_TEST = 0x0C11, SBL__GL_COLOR_WRITEMASK = 0x0C23, SBL__GL_DITHER = 0x0BD0,
    SBL__GL_UNPACK_SWAP_BYTES = 0x0CF0, SBL__GL_UNPACK_LSB_FIRST = 0x0CF1, SBL__GL_UNPACK_ROW_LENGTH = 0x0CF2,
    SBL__GL_UNPACK_SKIP_ROWS = 0x0CF3, SBL__GL_UNPACK_SKIP_PIXELS = 0x0CF4, SBL__GL_UNPACK_ALIGNMENT = 0x0CF5,
    SBL__GL_PACK_SWAP_BYTES = 0x0D00, SBL__GL_PACK_LSB_FIRST = 0x0D01, SBL__GL_PACK_ROW_LENGTH = 0x0D02,
    SBL__GL_PACK_SKIP_ROWS = 0x0D03, SBL__GL_PACK_SKIP_PIXELS = 0x0D04, SBL__GL_PACK_ALIGNMENT = 0x0D05,
    SBL__GL_PACK_SKIP_IMAGES = 0x806B, SBL__GL_PACK_IMAGE_HEIGHT = 0x806C, SBL__GL_UNPACK_SKIP_IMAGES = 0x806D, SBL__GL_UNPACK_IMAGE_HEIGHT = 0x806E,
    SBL__GL_MAX_TEXTURE_SIZE = 0x0D33, SBL__GL_TEXTURE_2D = 0x0DE1, SBL__GL_TEXTURE_WIDTH = 0x1000, SBL__GL_TEXTURE_HEIGHT = 0x1001,
    SBL__GL_UNSIGNED_BYTE = 0x1401, SBL__GL_UNSIGNED_SHORT = 0x1403, SBL__GL_UNSIGNED_INT = 0x1405, SBL__GL_FLOAT = 0x1406, SBL__GL_HALF_FLOAT = 0x140B,
    SBL__GL_COLOR = 0x1800, SBL__GL_DEPTH = 0x1801, SBL__GL_DEPTH_COMPONENT = 0x1902, SBL__GL_RED = 0x1903, SBL__GL_RGB = 0x1907, SBL__GL_RGBA = 0x1908,
    SBL__GL_RENDERER = 0x1F01, SBL__GL_VERSION = 0x1F02, SBL__GL_EXTENSIONS = 0x1F03,
    SBL__GL_NEAREST = 0x2600, SBL__GL_TEXTURE_MAG_FILTER = 0x2800, SBL__GL_TEXTURE_MIN_FILTER = 0x2801, SBL__GL_TEXTURE_WRAP_S = 0x2802,
    SBL__GL_TEXTURE_WRAP_T = 0x2803, SBL__GL_TEXTURE_MAX_LEVEL = 0x813D, SBL__GL_CLAMP_TO_EDGE = 0x812F,
    SBL__GL_POLYGON_OFFSET_FILL = 0x8037, SBL__GL_RGBA16 = 0x805B, SBL__GL_TEXTURE_BINDING_2D = 0x8069, SBL__GL_POLYGON_SMOOTH = 0x0B41,
    SBL__GL_MULTISAMPLE = 0x809D, SBL__GL_SAMPLE_ALPHA_TO_COVERAGE = 0x809E, SBL__GL_SAMPLE_ALPHA_TO_ONE = 0x809F, SBL__GL_SAMPLE_COVERAGE = 0x80A0,
    SBL__GL_SAMPLE_SHADING = 0x8C36, SBL__GL_SAMPLE_MASK = 0x8E51,
    SBL__GL_MAJOR_VERSION = 0x821B, SBL__GL_MINOR_VERSION = 0x821C, SBL__GL_NUM_EXTENSIONS = 0x821D, SBL__GL_RG = 0x8227, SBL__GL_RED_INTEGER = 0x8D94, SBL__GL_RGBA_INTEGER = 0x8D99,
    SBL__GL_R32F = 0x822E, SBL__GL_RG32F = 0x8230, SBL__GL_R32UI = 0x8236, SBL__GL_RGBA32UI = 0x8D70, SBL__GL_RGBA32F = 0x8814, SBL__GL_RGBA16F = 0x881A, SBL__GL_RG32UI = 0x823C,
    SBL__GL_SRGB8_ALPHA8 = 0x8C43, SBL__GL_DEPTH_COMPONENT32F = 0x8CAC,
    SBL__GL_TEXTURE0 = 0x84C0, SBL__GL_ACTIVE_TEXTURE = 0x84E0, SBL__GL_DEPTH_CLAMP = 0x864F, SBL__GL_VERTEX_ARRAY_BINDING = 0x85B5,
    SBL__GL_MAX_VIEWPORTS = 0x825B, SBL__GL_CLAMP_READ_COLOR = 0x891C, SBL__GL_BUFFER_SIZE = 0x8764,
    SBL__GL_ARRAY_BUFFER = 0x8892, SBL__GL_ELEMENT_ARRAY_BUFFER = 0x8893, SBL__GL_ARRAY_BUFFER_BINDING = 0x8894,
    SBL__GL_STREAM_DRAW = 0x88E0, SBL__GL_STATIC_DRAW = 0x88E4, SBL__GL_PIXEL_PACK_BUFFER = 0x88EB, SBL__GL_PIXEL_UNPACK_BUFFER = 0x88EC,
    SBL__GL_PIXEL_PACK_BUFFER_BINDING = 0x88ED, SBL__GL_PIXEL_UNPACK_BUFFER_BINDING = 0x88EF, SBL__GL_SAMPLER_BINDING = 0x8919,
    SBL__GL_FRAGMENT_SHADER = 0x8B30, SBL__GL_VERTEX_SHADER = 0x8B31, SBL__GL_COMPILE_STATUS = 0x8B81, SBL__GL_LINK_STATUS = 0x8B82,
    SBL__GL_CURRENT_PROGRAM = 0x8B8D, SBL__GL_TEXTURE_BUFFER = 0x8C2A, SBL__GL_MAX_TEXTURE_BUFFER_SIZE = 0x8C2B, SBL__GL_TEXTURE_BINDING_BUFFER = 0x8C2C,
    SBL__GL_RASTERIZER_DISCARD = 0x8C89, SBL__GL_DRAW_FRAMEBUFFER_BINDING = 0x8CA6, SBL__GL_READ_FRAMEBUFFER = 0x8CA8, SBL__GL_DRAW_FRAMEBUFFER = 0x8CA9,
    SBL__GL_READ_FRAMEBUFFER_BINDING = 0x8CAA, SBL__GL_FRAMEBUFFER_COMPLETE = 0x8CD5, SBL__GL_COLOR_ATTACHMENT0 = 0x8CE0, SBL__GL_DEPTH_ATTACHMENT = 0x8D00,
    SBL__GL_FRAMEBUFFER = 0x8D40, SBL__GL_FRAMEBUFFER_SRGB = 0x8DB9, SBL__GL_PRIMITIVE_RESTART_FIXED_INDEX = 0x8D69, SBL__GL_COPY_READ_BUFFER = 0x8F36,
    SBL__GL_PRIMITIVE_RESTART = 0x8F9D, SBL__GL_CLIP_DISTANCE0 = 0x3000,
    SBL__GL_IMAGE_BINDING_NAME = 0x8F3A, SBL__GL_IMAGE_BINDING_LEVEL = 0x8F3B, SBL__GL_IMAGE_BINDING_LAYERED = 0x8F3C, SBL__GL_IMAGE_BINDING_LAYER = 0x8F3D,
    SBL__GL_IMAGE_BINDING_ACCESS = 0x8F3E, SBL__GL_IMAGE_BINDING_FORMAT = 0x906E, SBL__GL_COMPUTE_SHADER = 0x91B9, SBL__GL_WRITE_ONLY = 0x88B9,
    SBL__GL_TEXTURE_FETCH_BARRIER = 0x0008, SBL__GL_SHADER_IMAGE_ACCESS_BARRIER = 0x0020, SBL__GL_FRAMEBUFFER_BARRIER = 0x0400,
    SBL__GL_CLIP_ORIGIN = 0x935C, SBL__GL_CLIP_DEPTH_MODE = 0x935D, SBL__GL_LOWER_LEFT = 0x8CA1, SBL__GL_NEGATIVE_ONE_TO_ONE = 0x935E, SBL__GL_ZERO_TO_ONE = 0x935F
};

/* Clears the error flags; the worst found becomes the result. what: the work that was done, for the message. */
static sbl_result sbl__gl_check(const sbl__gl *gl, const char *what) {
    sbl_result result = SBL_SUCCESS;
    int i;
    for (i = 0; i < 32; i++) {  /* a lost context reports errors for ever */
        unsigned error = gl->GetError();
        if (error == SBL__GL_NO_ERROR) break;
        if (error == SBL__GL_OUT_OF_MEMORY) {
            sbl__log(gl->base, SBL_LOG_ERROR, SBL_LOG_ITEM_OUT_OF_MEMORY, "the GPU is out of memory while %s; use a smaller scene, picture or atlas", what);
            result = SBL_ERROR_OUT_OF_MEMORY;
        } else {
            sbl__log(gl->base, SBL_LOG_ERROR, SBL_LOG_ITEM_GL_ERROR, "GL error 0x%04x while %s", error, what);
            if (result == SBL_SUCCESS) result = SBL_ERROR_GL;
        }
    }
    return result;
}

static void sbl__gl_clear_errors(const sbl__gl *gl) {
    int i;
    for (i = 0; i < 32 && gl->GetError() != SBL__GL_NO_ERROR; i++) {}
}

static int sbl__gl_has_extension(const sbl__gl *gl, const char *name) {
    int i, count = 0;
    gl->GetIntegerv(SBL__GL_NUM_EXTENSIONS, &count);
    for (i = 0; i < count; i++) {
        const char *extension = (const char *)gl->GetStringi(SBL__GL_EXTENSIONS, (unsigned)i);
        if (extension && strcmp(extension, name) == 0) return 1;
    }
    return 0;
}

static sbl_result sbl__gl_load(sbl__gl *gl, sbl__base *base, const sbl_context_desc *desc) {
    int missing = 0;
    sbl_capabilities *c = &gl->capabilities;
    const char *text;
    gl->base = base;
#define SBL__X(type, name, parameters)                                                                                  \
    gl->name = (type (SBL__GLAPI *) parameters)desc->get_gl_function("gl" #name, desc->gl_user);                        \
    if (!gl->name) {                                                                                                    \
        missing++;                                                                                                      \
        sbl__log(base, SBL_LOG_ERROR, SBL_LOG_ITEM_GL_FUNCTION_MISSING,                                                 \
                 "the GL loader does not know gl" #name "; sbl.h needs OpenGL 3.3 core, current in this thread");        \
    }
    SBL__GL_FUNCTIONS(SBL__X)
#undef SBL__X
    if (missing) return SBL_ERROR_UNSUPPORTED;
#define SBL__X(type, name, parameters) gl->name = (type (SBL__GLAPI *) parameters)desc->get_gl_function("gl" #name, desc->gl_user);
    SBL__GL_OPTIONAL_FUNCTIONS(SBL__X)
#undef SBL__X
    sbl__gl_clear_errors(gl);
    text = (const char *)gl->GetString(SBL__GL_VERSION);
    if (text) snprintf(c->version, sizeof c->version, "%s", text);
    text = (const char *)gl->GetString(SBL__GL_RENDERER);
    if (text) snprintf(c->renderer, sizeof c->renderer, "%s", text);
    gl->GetIntegerv(SBL__GL_MAJOR_VERSION, &c->gl_major);
    gl->GetIntegerv(SBL__GL_MINOR_VERSION, &c->gl_minor);
    if (c->gl_major * 10 + c->gl_minor < 33 || strstr(c->version, "OpenGL ES")) {
        sbl__log(base, SBL_LOG_ERROR, SBL_LOG_ITEM_NO_GL, "the current GL context is \"%s\"; sbl.h needs OpenGL 3.3 or later, and the context current in this thread",
                 c->version[0] ? c->version : "none");
        return SBL_ERROR_UNSUPPORTED;
    }
    gl->GetIntegerv(SBL__GL_MAX_TEXTURE_SIZE, &c->max_texture_size);
    gl->GetIntegerv(SBL__GL_MAX_TEXTURE_BUFFER_SIZE, &c->max_texture_buffer_size);
    if (gl->ClipControl && (c->gl_major * 10 + c->gl_minor >= 45 || sbl__gl_has_extension(gl, "GL_ARB_clip_control")))
        c->available |= SBL_CAPABILITY_CLIP_CONTROL;
    if (c->gl_major * 10 + c->gl_minor >= 43 && gl->BindImageTexture && gl->DispatchCompute && gl->GetIntegeri_v && gl->MemoryBarrier)
        c->available |= SBL_CAPABILITY_COMPUTE;
    c->used = c->available & ~desc->disabled;
    gl->viewports = 1;
    if (c->gl_major * 10 + c->gl_minor >= 41 && gl->DepthRangeIndexed && gl->GetDoublei_v && gl->GetFloati_v && gl->GetIntegeri_v && gl->ScissorIndexedv && gl->ViewportIndexedfv) {
        gl->GetIntegerv(SBL__GL_MAX_VIEWPORTS, &gl->viewports);
        gl->viewports = SBL__MAX(1, SBL__MIN(gl->viewports, SBL__GUARD_VIEWPORTS));
    }
    sbl__gl_clear_errors(gl);
    return SBL_SUCCESS;
}

static int sbl__gl_at_least(const sbl__gl *gl, int version) { return gl->capabilities.gl_major * 10 + gl->capabilities.gl_minor >= version; }

/* The state guard: everything sbl.h changes, saved on the way in and put back on the way out.
   sbl__guard_force sets what all passes rely on; it is called again after the host's draw callback. */


static const struct { unsigned name; int needed; } sbl__guard_switches[] = {  /* needed: GL version that has it */
    { SBL__GL_CULL_FACE, 33 }, { SBL__GL_DEPTH_TEST, 33 }, { SBL__GL_STENCIL_TEST, 33 }, { SBL__GL_SCISSOR_TEST, 33 }, { SBL__GL_COLOR_LOGIC_OP, 33 },
    { SBL__GL_DITHER, 33 }, { SBL__GL_POLYGON_OFFSET_FILL, 33 }, { SBL__GL_POLYGON_SMOOTH, 33 }, { SBL__GL_MULTISAMPLE, 33 },
    { SBL__GL_SAMPLE_ALPHA_TO_COVERAGE, 33 }, { SBL__GL_SAMPLE_ALPHA_TO_ONE, 33 }, { SBL__GL_SAMPLE_COVERAGE, 33 }, { SBL__GL_SAMPLE_MASK, 33 },
    { SBL__GL_DEPTH_CLAMP, 33 }, { SBL__GL_RASTERIZER_DISCARD, 33 }, { SBL__GL_FRAMEBUFFER_SRGB, 33 }, { SBL__GL_PRIMITIVE_RESTART, 33 },
    { SBL__GL_CLIP_DISTANCE0, 33 }, { SBL__GL_CLIP_DISTANCE0 + 1, 33 }, { SBL__GL_CLIP_DISTANCE0 + 2, 33 }, { SBL__GL_CLIP_DISTANCE0 + 3, 33 },
    { SBL__GL_CLIP_DISTANCE0 + 4, 33 }, { SBL__GL_CLIP_DISTANCE0 + 5, 33 }, { SBL__GL_CLIP_DISTANCE0 + 6, 33 }, { SBL__GL_CLIP_DISTANCE0 + 7, 33 },
    { SBL__GL_SAMPLE_SHADING, 40 }, { SBL__GL_PRIMITIVE_RESTART_FIXED_INDEX, 43 }
};

static const struct { unsigned name; int value; } sbl__guard_pixel_store[] = {
    { SBL__GL_UNPACK_SWAP_BYTES, 0 }, { SBL__GL_UNPACK_LSB_FIRST, 0 }, { SBL__GL_UNPACK_ROW_LENGTH, 0 }, { SBL__GL_UNPACK_SKIP_ROWS, 0 },
    { SBL__GL_UNPACK_SKIP_PIXELS, 0 }, { SBL__GL_UNPACK_ALIGNMENT, 1 }, { SBL__GL_UNPACK_SKIP_IMAGES, 0 }, { SBL__GL_UNPACK_IMAGE_HEIGHT, 0 },
    { SBL__GL_PACK_SWAP_BYTES, 0 }, { SBL__GL_PACK_LSB_FIRST, 0 }, { SBL__GL_PACK_ROW_LENGTH, 0 }, { SBL__GL_PACK_SKIP_ROWS, 0 },
    { SBL__GL_PACK_SKIP_PIXELS, 0 }, { SBL__GL_PACK_ALIGNMENT, 1 }, { SBL__GL_PACK_SKIP_IMAGES, 0 }, { SBL__GL_PACK_IMAGE_HEIGHT, 0 }
};

static const unsigned sbl__guard_image[6] = {  /* in the order of glBindImageTexture */
    SBL__GL_IMAGE_BINDING_NAME, SBL__GL_IMAGE_BINDING_LEVEL, SBL__GL_IMAGE_BINDING_LAYERED, SBL__GL_IMAGE_BINDING_LAYER, SBL__GL_IMAGE_BINDING_ACCESS, SBL__GL_IMAGE_BINDING_FORMAT
};

typedef struct sbl__guard {
    unsigned char switches[32], blend[SBL__GUARD_DRAW_BUFFERS], color_mask[SBL__GUARD_DRAW_BUFFERS][4], depth_mask;
    int pixel_store[16], polygon_mode[2], front_face, clamp_read, depth_function, clip_origin, clip_depth;
    unsigned char scissor_test[SBL__GUARD_VIEWPORTS];
    int viewport[4], scissor[4], scissors[SBL__GUARD_VIEWPORTS][4];  /* the arrays where there are such */
    float viewports[SBL__GUARD_VIEWPORTS][4];
    double depth_range[2], depth_ranges[SBL__GUARD_VIEWPORTS][2];
    int program, vertex_array, array_buffer, texture_buffer, copy_buffer, pack_buffer, unpack_buffer, draw_framebuffer, read_framebuffer, active_texture;
    int textures_2d[SBL__GUARD_UNITS], textures_buffer[SBL__GUARD_UNITS], samplers[SBL__GUARD_UNITS], images[SBL__GUARD_IMAGES][6];
} sbl__guard;

static void sbl__guard_save(const sbl__gl *gl, sbl__guard *g) {
    int i;
    memset(g, 0, sizeof *g);
    sbl__gl_clear_errors(gl);
    for (i = 0; i < SBL__COUNT(sbl__guard_switches); i++)
        if (sbl__gl_at_least(gl, sbl__guard_switches[i].needed)) g->switches[i] = gl->IsEnabled(sbl__guard_switches[i].name);
    for (i = 0; i < SBL__GUARD_DRAW_BUFFERS; i++) {
        g->blend[i] = gl->IsEnabledi(SBL__GL_BLEND, (unsigned)i);
        gl->GetBooleani_v(SBL__GL_COLOR_WRITEMASK, (unsigned)i, g->color_mask[i]);
    }
    gl->GetBooleanv(SBL__GL_DEPTH_WRITEMASK, &g->depth_mask);
    for (i = 0; i < SBL__COUNT(sbl__guard_pixel_store); i++) gl->GetIntegerv(sbl__guard_pixel_store[i].name, &g->pixel_store[i]);
    gl->GetIntegerv(SBL__GL_POLYGON_MODE, g->polygon_mode);
    gl->GetIntegerv(SBL__GL_FRONT_FACE, &g->front_face);
    gl->GetIntegerv(SBL__GL_CLAMP_READ_COLOR, &g->clamp_read);
    gl->GetIntegerv(SBL__GL_DEPTH_FUNC, &g->depth_function);
    gl->GetIntegerv(SBL__GL_VIEWPORT, g->viewport);
    gl->GetIntegerv(SBL__GL_SCISSOR_BOX, g->scissor);
    gl->GetDoublev(SBL__GL_DEPTH_RANGE, g->depth_range);
    for (i = 0; gl->viewports > 1 && i < gl->viewports; i++) {
        g->scissor_test[i] = gl->IsEnabledi(SBL__GL_SCISSOR_TEST, (unsigned)i);
        gl->GetFloati_v(SBL__GL_VIEWPORT, (unsigned)i, g->viewports[i]);
        gl->GetIntegeri_v(SBL__GL_SCISSOR_BOX, (unsigned)i, g->scissors[i]);
        gl->GetDoublei_v(SBL__GL_DEPTH_RANGE, (unsigned)i, g->depth_ranges[i]);
    }
    if (gl->capabilities.available & SBL_CAPABILITY_CLIP_CONTROL) {
        gl->GetIntegerv(SBL__GL_CLIP_ORIGIN, &g->clip_origin);
        gl->GetIntegerv(SBL__GL_CLIP_DEPTH_MODE, &g->clip_depth);
    }
    gl->GetIntegerv(SBL__GL_CURRENT_PROGRAM, &g->program);
    gl->GetIntegerv(SBL__GL_VERTEX_ARRAY_BINDING, &g->vertex_array);
    gl->GetIntegerv(SBL__GL_ARRAY_BUFFER_BINDING, &g->array_buffer);
    gl->GetIntegerv(SBL__GL_TEXTURE_BUFFER, &g->texture_buffer);   /* the buffer's binding is asked by the target's name */
    gl->GetIntegerv(SBL__GL_COPY_READ_BUFFER, &g->copy_buffer);    /* likewise */
    gl->GetIntegerv(SBL__GL_PIXEL_PACK_BUFFER_BINDING, &g->pack_buffer);
    gl->GetIntegerv(SBL__GL_PIXEL_UNPACK_BUFFER_BINDING, &g->unpack_buffer);
    gl->GetIntegerv(SBL__GL_DRAW_FRAMEBUFFER_BINDING, &g->draw_framebuffer);
    gl->GetIntegerv(SBL__GL_READ_FRAMEBUFFER_BINDING, &g->read_framebuffer);
    gl->GetIntegerv(SBL__GL_ACTIVE_TEXTURE, &g->active_texture);
    for (i = 0; i < SBL__GUARD_UNITS; i++) {
        gl->ActiveTexture(SBL__GL_TEXTURE0 + (unsigned)i);
        gl->GetIntegerv(SBL__GL_TEXTURE_BINDING_2D, &g->textures_2d[i]);
        gl->GetIntegerv(SBL__GL_TEXTURE_BINDING_BUFFER, &g->textures_buffer[i]);
        gl->GetIntegerv(SBL__GL_SAMPLER_BINDING, &g->samplers[i]);
    }
    for (i = 0; gl->capabilities.used & SBL_CAPABILITY_COMPUTE && i < 6 * SBL__GUARD_IMAGES; i++)
        gl->GetIntegeri_v(sbl__guard_image[i % 6], (unsigned)i / 6, &g->images[i / 6][i % 6]);
    sbl__gl_clear_errors(gl);  /* a binding that an old driver cannot be asked for reads 0 */
}

static void sbl__guard_force(const sbl__gl *gl) {
    int i;
    for (i = 0; i < SBL__COUNT(sbl__guard_switches); i++)
        if (sbl__gl_at_least(gl, sbl__guard_switches[i].needed)) gl->Disable(sbl__guard_switches[i].name);
    gl->Enable(SBL__GL_DEPTH_CLAMP);
    for (i = 0; i < SBL__GUARD_DRAW_BUFFERS; i++) {
        gl->Disablei(SBL__GL_BLEND, (unsigned)i);
        gl->ColorMaski((unsigned)i, 1, 1, 1, 1);
    }
    gl->DepthMask(1);
    for (i = 0; i < SBL__COUNT(sbl__guard_pixel_store); i++) gl->PixelStorei(sbl__guard_pixel_store[i].name, sbl__guard_pixel_store[i].value);
    gl->PolygonMode(SBL__GL_FRONT_AND_BACK, SBL__GL_FILL);
    gl->ClampColor(SBL__GL_CLAMP_READ_COLOR, 0);
    gl->FrontFace(SBL__GL_CCW);
    gl->DepthFunc(SBL__GL_GREATER);
    gl->DepthRange(0, 1);
    if (gl->capabilities.available & SBL_CAPABILITY_CLIP_CONTROL)
        gl->ClipControl(SBL__GL_LOWER_LEFT, gl->capabilities.used & SBL_CAPABILITY_CLIP_CONTROL ? SBL__GL_ZERO_TO_ONE : SBL__GL_NEGATIVE_ONE_TO_ONE);
    gl->BindBuffer(SBL__GL_PIXEL_PACK_BUFFER, 0);
    gl->BindBuffer(SBL__GL_PIXEL_UNPACK_BUFFER, 0);
    for (i = 0; i < SBL__GUARD_UNITS; i++) gl->BindSampler((unsigned)i, 0);
    gl->ActiveTexture(SBL__GL_TEXTURE0);  /* textures are made on whatever unit is active: it must be one that is put back */
}

static void sbl__guard_restore(const sbl__gl *gl, const sbl__guard *g) {
    int i;
    for (i = 0; i < SBL__COUNT(sbl__guard_switches); i++)
        if (sbl__gl_at_least(gl, sbl__guard_switches[i].needed)) {
            if (g->switches[i]) gl->Enable(sbl__guard_switches[i].name); else gl->Disable(sbl__guard_switches[i].name);
        }
    for (i = 0; i < SBL__GUARD_DRAW_BUFFERS; i++) {
        if (g->blend[i]) gl->Enablei(SBL__GL_BLEND, (unsigned)i); else gl->Disablei(SBL__GL_BLEND, (unsigned)i);
        gl->ColorMaski((unsigned)i, g->color_mask[i][0], g->color_mask[i][1], g->color_mask[i][2], g->color_mask[i][3]);
    }
    gl->DepthMask(g->depth_mask);
    for (i = 0; i < SBL__COUNT(sbl__guard_pixel_store); i++) gl->PixelStorei(sbl__guard_pixel_store[i].name, g->pixel_store[i]);
    gl->PolygonMode(SBL__GL_FRONT_AND_BACK, (unsigned)g->polygon_mode[0]);
    gl->ClampColor(SBL__GL_CLAMP_READ_COLOR, (unsigned)g->clamp_read);
    gl->FrontFace((unsigned)g->front_face);
    gl->DepthFunc((unsigned)g->depth_function);
    gl->DepthRange(g->depth_range[0], g->depth_range[1]);
    gl->Viewport(g->viewport[0], g->viewport[1], g->viewport[2], g->viewport[3]);
    gl->Scissor(g->scissor[0], g->scissor[1], g->scissor[2], g->scissor[3]);
    for (i = 0; gl->viewports > 1 && i < gl->viewports; i++) {
        if (g->scissor_test[i]) gl->Enablei(SBL__GL_SCISSOR_TEST, (unsigned)i); else gl->Disablei(SBL__GL_SCISSOR_TEST, (unsigned)i);
        gl->ViewportIndexedfv((unsigned)i, g->viewports[i]);
        gl->ScissorIndexedv((unsigned)i, g->scissors[i]);
        gl->DepthRangeIndexed((unsigned)i, g->depth_ranges[i][0], g->depth_ranges[i][1]);
    }
    if (gl->capabilities.available & SBL_CAPABILITY_CLIP_CONTROL) gl->ClipControl((unsigned)g->clip_origin, (unsigned)g->clip_depth);
    for (i = 0; i < SBL__GUARD_UNITS; i++) {
        gl->ActiveTexture(SBL__GL_TEXTURE0 + (unsigned)i);
        gl->BindTexture(SBL__GL_TEXTURE_2D, (unsigned)g->textures_2d[i]);
        gl->BindTexture(SBL__GL_TEXTURE_BUFFER, (unsigned)g->textures_buffer[i]);
        gl->BindSampler((unsigned)i, (unsigned)g->samplers[i]);
    }
    for (i = 0; gl->capabilities.used & SBL_CAPABILITY_COMPUTE && i < SBL__GUARD_IMAGES; i++) {
        const int *m = g->images[i];
        gl->BindImageTexture((unsigned)i, (unsigned)m[0], m[1], (unsigned char)m[2], m[3], (unsigned)m[4], (unsigned)m[5]);
    }
    gl->ActiveTexture((unsigned)g->active_texture);
    gl->UseProgram((unsigned)g->program);
    gl->BindVertexArray((unsigned)g->vertex_array);
    gl->BindBuffer(SBL__GL_ARRAY_BUFFER, (unsigned)g->array_buffer);
    gl->BindBuffer(SBL__GL_TEXTURE_BUFFER, (unsigned)g->texture_buffer);
    gl->BindBuffer(SBL__GL_COPY_READ_BUFFER, (unsigned)g->copy_buffer);
    gl->BindBuffer(SBL__GL_PIXEL_PACK_BUFFER, (unsigned)g->pack_buffer);
    gl->BindBuffer(SBL__GL_PIXEL_UNPACK_BUFFER, (unsigned)g->unpack_buffer);
    gl->BindFramebuffer(SBL__GL_DRAW_FRAMEBUFFER, (unsigned)g->draw_framebuffer);
    gl->BindFramebuffer(SBL__GL_READ_FRAMEBUFFER, (unsigned)g->read_framebuffer);
}

/* GL objects. Creation logs and returns what failed; deletion ignores objects that were never made. */

/* A new name, or 0 (logged) where GL gives none: binding that would change the host's default objects. */
static unsigned sbl__name_make(const sbl__gl *gl, void (SBL__GLAPI *generate)(int, unsigned *), const char *what) {
    unsigned name = 0;
    generate(1, &name);
    if (!name) sbl__log(gl->base, SBL_LOG_ERROR, SBL_LOG_ITEM_GL_ERROR, "GL gave no name while %s", what);
    return name;
}

typedef struct sbl__texture { unsigned id; int width, height; unsigned internal_format; size_t bytes; } sbl__texture;
typedef struct sbl__buffer { unsigned id; size_t bytes; } sbl__buffer;

static const struct { unsigned internal_format, format, type; int bytes, components; } sbl__formats[] = {
    { SBL__GL_R32F, SBL__GL_RED, SBL__GL_FLOAT, 4, 1 },
    { SBL__GL_R32UI, SBL__GL_RED_INTEGER, SBL__GL_UNSIGNED_INT, 4, 1 },
    { SBL__GL_RG32F, SBL__GL_RG, SBL__GL_FLOAT, 8, 2 },
    { SBL__GL_RGBA16F, SBL__GL_RGBA, SBL__GL_HALF_FLOAT, 8, 4 },
    { SBL__GL_RGBA32F, SBL__GL_RGBA, SBL__GL_FLOAT, 16, 4 },
    { SBL__GL_RGBA32UI, SBL__GL_RGBA_INTEGER, SBL__GL_UNSIGNED_INT, 16, 4 },
    { SBL__GL_SRGB8_ALPHA8, SBL__GL_RGBA, SBL__GL_UNSIGNED_BYTE, 4, 4 },
    { SBL__GL_DEPTH_COMPONENT32F, SBL__GL_DEPTH_COMPONENT, SBL__GL_FLOAT, 4, 1 }
};

static int sbl__format(unsigned internal_format) {
    int i = 0;
    while (sbl__formats[i].internal_format != internal_format) i++;
    return i;
}

static void sbl__gpu_account(sbl__base *base, size_t before, size_t after) {
    base->memory.gpu_bytes = base->memory.gpu_bytes - before + after;
    if (base->memory.gpu_bytes > base->memory.gpu_peak_bytes) base->memory.gpu_peak_bytes = base->memory.gpu_bytes;
}

static void sbl__texture_delete(const sbl__gl *gl, sbl__texture *t) {
    if (t->id) gl->DeleteTextures(1, &t->id);
    sbl__gpu_account(gl->base, t->bytes, 0);
    memset(t, 0, sizeof *t);
}

/* pixels: NULL, or the whole texture in the format's own layout. Keeps the object where size and format are the same. */
static sbl_result sbl__texture_make(const sbl__gl *gl, sbl__texture *t, int width, int height, unsigned internal_format, const void *pixels, const char *what) {
    int f = sbl__format(internal_format);
    sbl_result result;
    if (t->id && t->width == width && t->height == height && t->internal_format == internal_format) {
        if (pixels) {
            gl->BindTexture(SBL__GL_TEXTURE_2D, t->id);
            gl->TexSubImage2D(SBL__GL_TEXTURE_2D, 0, 0, 0, width, height, sbl__formats[f].format, sbl__formats[f].type, pixels);
            return sbl__gl_check(gl, what);
        }
        return SBL_SUCCESS;
    }
    sbl__texture_delete(gl, t);
    t->id = sbl__name_make(gl, gl->GenTextures, what);
    if (!t->id) return SBL_ERROR_GL;
    gl->BindTexture(SBL__GL_TEXTURE_2D, t->id);
    gl->TexImage2D(SBL__GL_TEXTURE_2D, 0, (int)internal_format, width, height, 0, sbl__formats[f].format, sbl__formats[f].type, pixels);
    gl->TexParameteri(SBL__GL_TEXTURE_2D, SBL__GL_TEXTURE_MIN_FILTER, SBL__GL_NEAREST);
    gl->TexParameteri(SBL__GL_TEXTURE_2D, SBL__GL_TEXTURE_MAG_FILTER, SBL__GL_NEAREST);
    gl->TexParameteri(SBL__GL_TEXTURE_2D, SBL__GL_TEXTURE_WRAP_S, SBL__GL_CLAMP_TO_EDGE);
    gl->TexParameteri(SBL__GL_TEXTURE_2D, SBL__GL_TEXTURE_WRAP_T, SBL__GL_CLAMP_TO_EDGE);
    gl->TexParameteri(SBL__GL_TEXTURE_2D, SBL__GL_TEXTURE_MAX_LEVEL, 0);
    result = sbl__gl_check(gl, what);
    if (result != SBL_SUCCESS) { sbl__texture_delete(gl, t); return result; }
    t->width = width; t->height = height; t->internal_format = internal_format;
    t->bytes = (size_t)width * (size_t)height * (size_t)sbl__formats[f].bytes;
    sbl__gpu_account(gl->base, 0, t->bytes);
    return SBL_SUCCESS;
}

static void sbl__buffer_delete(const sbl__gl *gl, sbl__buffer *b) {
    if (b->id) gl->DeleteBuffers(1, &b->id);
    sbl__gpu_account(gl->base, b->bytes, 0);
    memset(b, 0, sizeof *b);
}

static sbl_result sbl__buffer_make(const sbl__gl *gl, sbl__buffer *b, size_t bytes, const void *data, unsigned usage, const char *what) {
    sbl_result result;
    if (!b->id) b->id = sbl__name_make(gl, gl->GenBuffers, what);
    if (!b->id) return SBL_ERROR_GL;
    gl->BindBuffer(SBL__GL_ARRAY_BUFFER, b->id);
    gl->BufferData(SBL__GL_ARRAY_BUFFER, (ptrdiff_t)SBL__MAX(bytes, 16), data && bytes >= 16 ? data : NULL, usage);
    if (data && bytes && bytes < 16) gl->BufferSubData(SBL__GL_ARRAY_BUFFER, 0, (ptrdiff_t)bytes, data);
    result = sbl__gl_check(gl, what);
    if (result != SBL_SUCCESS) { sbl__buffer_delete(gl, b); return result; }
    sbl__gpu_account(gl->base, b->bytes, bytes);
    b->bytes = bytes;
    return SBL_SUCCESS;
}

/* A buffer seen by shaders as texels. */
static sbl_result sbl__buffer_texture_make(const sbl__gl *gl, unsigned *id, unsigned internal_format, const sbl__buffer *b, const char *what) {
    if (!*id) *id = sbl__name_make(gl, gl->GenTextures, what);
    if (!*id) return SBL_ERROR_GL;
    gl->BindTexture(SBL__GL_TEXTURE_BUFFER, *id);
    gl->TexBuffer(SBL__GL_TEXTURE_BUFFER, internal_format, b->id);
    return sbl__gl_check(gl, what);
}

#define SBL__TEXELS_ACROSS 4096  /* as in scene.glsl; GL 3.3 promises 1024, every driver since has four times that or more */

/* The same for what grows with the scene; wide: copied into rows of a 2D texture, where the driver's buffer textures do not hold as much. */
static sbl_result sbl__texels_make(const sbl__gl *gl, sbl__texture *t, unsigned internal_format, const sbl__buffer *b, int wide, const char *what) {
    const int f = sbl__format(internal_format), bytes = sbl__formats[f].bytes;
    int rows = (int)(b->bytes / (size_t)bytes / SBL__TEXELS_ACROSS), rest = (int)(b->bytes / (size_t)bytes % SBL__TEXELS_ACROSS);
    sbl_result result;
    if (!wide) return sbl__buffer_texture_make(gl, &t->id, internal_format, b, what);
    result = sbl__texture_make(gl, t, SBL__TEXELS_ACROSS, rows + 1, internal_format, NULL, what);
    if (result != SBL_SUCCESS) return result;
    gl->BindTexture(SBL__GL_TEXTURE_2D, t->id);
    gl->BindBuffer(SBL__GL_PIXEL_UNPACK_BUFFER, b->id);
    if (rows) gl->TexSubImage2D(SBL__GL_TEXTURE_2D, 0, 0, 0, SBL__TEXELS_ACROSS, rows, sbl__formats[f].format, sbl__formats[f].type, NULL);
    if (rest) gl->TexSubImage2D(SBL__GL_TEXTURE_2D, 0, 0, rows, rest, 1, sbl__formats[f].format, sbl__formats[f].type, (const void *)((uintptr_t)rows * SBL__TEXELS_ACROSS * (uintptr_t)bytes));
    gl->BindBuffer(SBL__GL_PIXEL_UNPACK_BUFFER, 0);
    return sbl__gl_check(gl, what);
}

static void sbl__name_delete(void (SBL__GLAPI *delete_names)(int, const unsigned *), unsigned *id) {
    if (*id) delete_names(1, id);
    *id = 0;
}

/* Makes (or makes anew) a framebuffer of the given colour attachments, and depth where not NULL, and leaves it bound to draw. */
static sbl_result sbl__framebuffer_make(const sbl__gl *gl, unsigned *id, const sbl__texture *const *colors, int count, const sbl__texture *depth, const char *what) {
    unsigned buffers[8], status;
    int i;
    sbl_result result;
    if (!*id) *id = sbl__name_make(gl, gl->GenFramebuffers, what);
    if (!*id) return SBL_ERROR_GL;
    gl->BindFramebuffer(SBL__GL_DRAW_FRAMEBUFFER, *id);
    for (i = 0; i < count; i++) {
        buffers[i] = SBL__GL_COLOR_ATTACHMENT0 + (unsigned)i;
        gl->FramebufferTexture2D(SBL__GL_DRAW_FRAMEBUFFER, buffers[i], SBL__GL_TEXTURE_2D, colors[i]->id, 0);
    }
    if (depth) gl->FramebufferTexture2D(SBL__GL_DRAW_FRAMEBUFFER, SBL__GL_DEPTH_ATTACHMENT, SBL__GL_TEXTURE_2D, depth->id, 0);
    gl->DrawBuffers(count, buffers);
    status = gl->CheckFramebufferStatus(SBL__GL_DRAW_FRAMEBUFFER);
    result = sbl__gl_check(gl, what);
    if (result == SBL_SUCCESS && status != SBL__GL_FRAMEBUFFER_COMPLETE) {
        sbl__log(gl->base, SBL_LOG_ERROR, SBL_LOG_ITEM_FRAMEBUFFER, "framebuffer status 0x%04x while %s; the driver cannot render to that format", status, what);
        result = SBL_ERROR_GL;
    }
    return result;
}

/* Reads pixels of a colour attachment of framebuffer id, in the texture's own components, floats or unsigned ints. */
static sbl_result sbl__read_pixels(const sbl__gl *gl, unsigned framebuffer, int attachment, const sbl__texture *t, int rows, void *out, const char *what) {
    int f = sbl__format(t->internal_format);
    unsigned type = sbl__formats[f].type == SBL__GL_UNSIGNED_INT ? (unsigned)SBL__GL_UNSIGNED_INT : (unsigned)SBL__GL_FLOAT;
    gl->BindFramebuffer(SBL__GL_READ_FRAMEBUFFER, framebuffer);
    gl->ReadBuffer(SBL__GL_COLOR_ATTACHMENT0 + (unsigned)attachment);
    gl->ReadPixels(0, 0, t->width, rows, sbl__formats[f].format, type, out);
    return sbl__gl_check(gl, what);
}

/* Shaders are lists of lines, see >>shaders; a program is GLSL version, defines, bodies. */

#define SBL__MAX_LINES 1000

static sbl_result sbl__shader_make(const sbl__gl *gl, unsigned *out, unsigned type, const char *name, const char *defines, const char *const *const *bodies) {
    const char *lines[SBL__MAX_LINES];
    int count = 0, ok = 0, body, line;
    char text[400];
    lines[count++] = type == SBL__GL_COMPUTE_SHADER ? "#version 430 core\n#define SBL_COMPUTE\n" : "#version 330 core\n";
    lines[count++] = defines;
    for (body = 0; bodies[body]; body++)
        for (line = 0; bodies[body][line] && count < SBL__MAX_LINES; line++) lines[count++] = bodies[body][line];
    *out = gl->CreateShader(type);
    if (*out) {
        gl->ShaderSource(*out, count, lines, NULL);
        gl->CompileShader(*out);
        gl->GetShaderiv(*out, SBL__GL_COMPILE_STATUS, &ok);
    }
    if (ok) return SBL_SUCCESS;
    memset(text, 0, sizeof text);
    if (*out) gl->GetShaderInfoLog(*out, (int)sizeof text - 1, NULL, text);
    sbl__log(gl->base, SBL_LOG_ERROR, SBL_LOG_ITEM_SHADER_COMPILE, "the driver refuses the shader \"%s\": %s", name, text);
    return SBL_ERROR_GL;
}

/* Of vertex and fragment shader; vertex NULL: of the second, as a compute shader. */
static sbl_result sbl__program_make(const sbl__gl *gl, unsigned *out, const char *name, const char *defines, const char *const *const *vertex, const char *const *const *fragment) {
    unsigned shaders[2] = { 0, 0 };
    int ok = 0;
    char text[400];
    sbl_result result = vertex ? sbl__shader_make(gl, &shaders[0], SBL__GL_VERTEX_SHADER, name, defines, vertex) : SBL_SUCCESS;
    if (result == SBL_SUCCESS) result = sbl__shader_make(gl, &shaders[1], vertex ? SBL__GL_FRAGMENT_SHADER : SBL__GL_COMPUTE_SHADER, name, defines, fragment);
    if (result == SBL_SUCCESS) {
        *out = gl->CreateProgram();
        if (*out) {
            if (vertex) gl->AttachShader(*out, shaders[0]);
            gl->AttachShader(*out, shaders[1]);
            gl->LinkProgram(*out);
            gl->GetProgramiv(*out, SBL__GL_LINK_STATUS, &ok);
        }
        if (!ok) {
            memset(text, 0, sizeof text);
            if (*out) gl->GetProgramInfoLog(*out, (int)sizeof text - 1, NULL, text);
            sbl__log(gl->base, SBL_LOG_ERROR, SBL_LOG_ITEM_SHADER_LINK, "the driver does not link the program \"%s\": %s", name, text);
            result = SBL_ERROR_GL;
        }
    }
    if (shaders[0]) gl->DeleteShader(shaders[0]);
    if (shaders[1]) gl->DeleteShader(shaders[1]);
    if (result == SBL_SUCCESS) result = sbl__gl_check(gl, "making shader programs");
    if (result != SBL_SUCCESS && *out) { gl->DeleteProgram(*out); *out = 0; }
    return result;
}

static int sbl__uniform(const sbl__gl *gl, unsigned program, const char *name) { return gl->GetUniformLocation(program, name); }
static void sbl__uniform_i(const sbl__gl *gl, unsigned program, const char *name, int x) { gl->Uniform1i(sbl__uniform(gl, program, name), x); }
static void sbl__uniform_f(const sbl__gl *gl, unsigned program, const char *name, float x) { gl->Uniform1f(sbl__uniform(gl, program, name), x); }

static void sbl__uniform_3(const sbl__gl *gl, unsigned program, const char *name, const float v[3]) {
    gl->Uniform3f(sbl__uniform(gl, program, name), v[0], v[1], v[2]);
}

/* Binds a texture to a unit and names the unit to the program in use. */
static void sbl__bind(const sbl__gl *gl, unsigned program, const char *name, int unit, unsigned target, unsigned texture) {
    gl->ActiveTexture(SBL__GL_TEXTURE0 + (unsigned)unit);
    gl->BindTexture(target, texture);
    sbl__uniform_i(gl, program, name, unit);
}

static void sbl__bind_texels(const sbl__gl *gl, unsigned program, const char *name, int unit, const sbl__texture *t) {
    sbl__bind(gl, program, name, unit, t->width ? SBL__GL_TEXTURE_2D : SBL__GL_TEXTURE_BUFFER, t->id);
}

/* ======================================================================================================== >>scene
   Meshes, materials, textures, sky: checked whole, then copied into a handful of GPU buffers that every later stage reads.

       positions   a vertex: x y z (float), object number                  16 bytes
       attributes  a vertex: normal, u, v, colour in 4 x 16 bits, 0        32 bytes
       indices     three 32-bit vertex numbers a triangle; triangle t of mesh m stands at meshes[m].first_triangle + t
       objects     a record of 5 x 4 32-bit words per mesh, see shaders_embedded/scene.glsl                           */

typedef struct sbl__attribute { float normal[3], uv[2]; uint16_t color[4]; uint32_t unused; } sbl__attribute;
typedef struct sbl__vertex { float position[3]; uint32_t object; } sbl__vertex;

typedef struct sbl__mesh {
    int first_vertex, vertex_count, first_triangle, triangle_count;
    float transform[16];
} sbl__mesh;

typedef struct sbl__bvh {     /* see >>bvh */
    uint32_t *nodes;             /* 8 words a node */
    uint32_t *order;             /* triangle numbers, leaf after leaf */
    int node_count, triangle_count, depth;
    float grid_origin[3], grid_per_length[3];
    double cost;                 /* nodes and triangles that a ray through a node's box meets on average, by the surface-area heuristic: the worst node's */
    double seconds;
} sbl__bvh;

typedef struct sbl__scene {
    sbl__mesh *meshes;
    int mesh_count;
    float *positions, *normals;    /* object space, 3 floats a vertex: what sbl_set_mesh_transform starts from */
    sbl__vertex *vertices;         /* world space, as on the GPU */
    sbl__attribute *attributes;
    uint32_t *indices;
    uint32_t *objects;
    int vertex_count, triangle_count;
    int textured;                  /* some material has a texture or a cutout, or some mesh vertex colours */
    float sky[3], max_radiance;    /* highest radiance of any emitter or the sky */
    float bounds[2][3];
    float extent;                  /* longest distance inside the bounds, plus how far they lie from the origin: sets offsets and depth */
    sbl_draw_function draw;
    void *draw_user;
    float draw_bounds[2][3];
    sbl__buffer position_buffer, attribute_buffer, index_buffer, object_buffer;
    sbl__texture position_texels, attribute_texels, index_texels, object_texels;  /* see sbl__texels_make */
    int wide;                      /* programs are of two kinds, see sbl__scene_programs_make */
    sbl__texture texels_srgb, texels_float;
    sbl__bvh bvh;                  /* built when a picture first traces rays; again after a mesh has moved */
    sbl__buffer node_buffer, triangle_buffer, lamp_buffer;
    sbl__texture node_texels, triangle_texels, lamp_texels;
    sbl_light *lights;
    int light_count;
    float *sky_pixels;             /* the environment's picture, scaled: r g b; NULL: there is none */
    int sky_width, sky_height;
    float sky_axes[3][3];          /* x, up, z of the picture in the world */
    float sky_limit;               /* radiance from which on a texel is a lamp; 0: there is no picture */
    sbl__texture sky_texels;
    float lamp_unit;               /* radiance of about the highest light that lamps give */
    int lamp_nodes, lamp_leaves;   /* see >>lamps */
    int bvh_ready;                 /* hierarchy and lamps */
    unsigned vertex_array;         /* positions, object, uv, colour; the sensors' views come with each batch */
} sbl__scene;

#define SBL__OBJECT_WORDS 20
#define SBL__SKY_LIMIT 4  /* mean radiances of the environment: what is brighter is a lamp; rays over the hemisphere meet the rest with little noise */
#define SBL__TEXEL_STORE_WIDTH 4096

static const struct { int bytes; double scale; } sbl__types[SBL_TYPE_COUNT] = {
    { 4, 1 }, { 2, 1 }, { 1, 1 / 255.0 }, { 2, 1 / 65535.0 }, { 1, 1 / 127.0 }, { 2, 1 / 32767.0 }, { 1, 1 }, { 2, 1 }, { 4, 1 }
};

static float sbl__component(const unsigned char *at, sbl_type type) {
    float f; uint16_t u16; int16_t i16; uint32_t u32;
    switch (type) {
        case SBL_FLOAT32: memcpy(&f, at, 4); return f;
        case SBL_FLOAT16: memcpy(&u16, at, 2); return sbl__from_half(u16);
        case SBL_UINT8_NORM: return (float)(*at * sbl__types[type].scale);
        case SBL_UINT16_NORM: memcpy(&u16, at, 2); return (float)(u16 * sbl__types[type].scale);
        case SBL_INT8_NORM: { int8_t i8; memcpy(&i8, at, 1); return (float)SBL__MAX(-1.0, i8 * sbl__types[type].scale); }
        case SBL_INT16_NORM: memcpy(&i16, at, 2); return (float)SBL__MAX(-1.0, i16 * sbl__types[type].scale);
        case SBL_UINT8: return (float)*at;
        case SBL_UINT16: memcpy(&u16, at, 2); return (float)u16;
        case SBL_UINT32: memcpy(&u32, at, 4); return (float)u32;
        default: return 0;
    }
}

static uint32_t sbl__index(const unsigned char *at, sbl_type type) {
    uint16_t u16; uint32_t u32;
    if (type == SBL_UINT8) return *at;
    if (type == SBL_UINT16) { memcpy(&u16, at, 2); return u16; }
    memcpy(&u32, at, 4);
    return u32;
}

/* A stream made readable: bytes start at element 0. `copy` is freed by the caller; it holds what came from a GL buffer. */
typedef struct sbl__reader { const unsigned char *bytes; size_t stride; sbl_type type; void *copy; } sbl__reader;

static int sbl__stream_present(const sbl_stream *s) { return s->data != NULL || s->gl_buffer != 0; }
static size_t sbl__stream_stride(const sbl_stream *s, int components) { return s->stride ? s->stride : (size_t)sbl__types[s->type].bytes * (size_t)components; }

typedef struct sbl__check { const sbl__base *base; int mistakes; } sbl__check;

#define SBL__MISTAKE(check, item, ...) ((check)->mistakes++, sbl__log((check)->base, SBL_LOG_ERROR, item, __VA_ARGS__))

/* name: the field, as "positions". integer: indices, whose types differ. Reports what is wrong; GL buffers are looked at, not read. */
static void sbl__check_stream(sbl__check *check, const sbl__gl *gl, int mesh, const char *name, const sbl_stream *s, int components, int count, int integer) {
    size_t element, stride;
    if (!sbl__stream_present(s)) return;
    if (s->data && s->gl_buffer)
        SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_MESH, "mesh %d: %s.data and %s.gl_buffer (%u) are both set; give one", mesh, name, name, s->gl_buffer);
    if ((int)s->type < 0 || (int)s->type >= SBL_TYPE_COUNT || (s->type >= SBL_UINT8) != integer) {
        SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_MESH, "mesh %d: %s.type is %d; %s", mesh, name, (int)s->type,
                     integer ? "indices are SBL_UINT8, SBL_UINT16 or SBL_UINT32" : "use a float or normalised type");
        return;
    }
    if (s->type == SBL_UINT8_NORM && components == 3)
        SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_MESH, "mesh %d: %s.type is %d, SBL_UINT8_NORM; it is for colours and texture coordinates only", mesh, name, (int)s->type);
    element = (size_t)sbl__types[s->type].bytes * (size_t)components;
    stride = sbl__stream_stride(s, components);
    if (stride < element)
        SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_MESH, "mesh %d: %s.stride is %.0f, less than the %.0f bytes of an element", mesh, name, (double)stride, (double)element);
    else if (count > 0 && ((size_t)count - 1 > (SIZE_MAX / 2 - element) / stride || s->offset > SIZE_MAX / 2))
        SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_MESH, "mesh %d: %s.offset %.0f and stride %.0f reach past the address space with %d elements", mesh, name,
                     (double)s->offset, (double)stride, count);
    else if (s->gl_buffer && count > 0) {
        int64_t size = 0;
        if (gl->IsBuffer(s->gl_buffer)) {
            gl->BindBuffer(SBL__GL_COPY_READ_BUFFER, s->gl_buffer);
            gl->GetBufferParameteri64v(SBL__GL_COPY_READ_BUFFER, SBL__GL_BUFFER_SIZE, &size);
        }
        if ((double)size < (double)s->offset + (double)stride * (count - 1) + (double)element)
            SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_MESH, "mesh %d: %s.gl_buffer %u holds %.0f bytes, %d elements from offset %.0f need %.0f", mesh, name,
                         s->gl_buffer, (double)size, count, (double)s->offset, (double)stride * (count - 1) + (double)element);
    }
}

static sbl_result sbl__reader_open(const sbl__gl *gl, sbl__reader *reader, const sbl_stream *s, int components, int count) {
    size_t bytes;
    memset(reader, 0, sizeof *reader);
    if (!sbl__stream_present(s) || count == 0) return SBL_SUCCESS;
    reader->stride = sbl__stream_stride(s, components);
    reader->type = s->type;
    reader->bytes = (const unsigned char *)s->data + s->offset;
    if (!s->gl_buffer) return SBL_SUCCESS;
    bytes = reader->stride * ((size_t)count - 1) + (size_t)sbl__types[s->type].bytes * (size_t)components;
    reader->bytes = (const unsigned char *)(reader->copy = sbl__alloc(gl->base, bytes, 1));
    if (!reader->copy) return SBL_ERROR_OUT_OF_MEMORY;
    gl->BindBuffer(SBL__GL_COPY_READ_BUFFER, s->gl_buffer);
    gl->GetBufferSubData(SBL__GL_COPY_READ_BUFFER, (ptrdiff_t)s->offset, (ptrdiff_t)bytes, reader->copy);
    return sbl__gl_check(gl, "reading a mesh from a GL buffer");
}

static void sbl__reader_close(const sbl__gl *gl, sbl__reader *reader) { sbl__free(gl->base, reader->copy); reader->copy = NULL; }

static void sbl__read_element(const sbl__reader *reader, int element, int components, float *out) {
    const unsigned char *at = reader->bytes + reader->stride * (size_t)element;
    int i;
    for (i = 0; i < components; i++) out[i] = sbl__component(at + i * sbl__types[reader->type].bytes, reader->type);
}

/* Determinant of the linear part; 0 where it is singular or the matrix is not affine. */
static double sbl__affine_determinant(const float m[16]) {
    if (m[3] != 0.0f || m[7] != 0.0f || m[11] != 0.0f || m[15] != 1.0f) return 0;
    return (double)m[0] * ((double)m[5] * m[10] - (double)m[6] * m[9]) - (double)m[4] * ((double)m[1] * m[10] - (double)m[2] * m[9]) +
           (double)m[8] * ((double)m[1] * m[6] - (double)m[2] * m[5]);
}

static void sbl__check_transform(sbl__check *check, int mesh, const float m[16]) {
    int i;
    for (i = 0; i < 16; i++)
        if (!sbl__finite(m[i])) { SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_MESH, "mesh %d: transform[%d] is %g; it must be finite", mesh, i, (double)m[i]); return; }
    if (!sbl__all_zero(m, 16) && sbl__affine_determinant(m) == 0)
        SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_MESH,
                     "mesh %d: transform is singular or not affine (its last row is %g %g %g %g, its determinant %g); it must be invertible with last row 0 0 0 1",
                     mesh, (double)m[3], (double)m[7], (double)m[11], (double)m[15], sbl__affine_determinant(m));
}

static void sbl__check_mesh(sbl__check *check, const sbl__gl *gl, const sbl_scene_desc *desc, int number) {
    const sbl_mesh *m = &desc->meshes[number];
    if (m->vertex_count < 0) { SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_MESH, "mesh %d: vertex_count is %d; it cannot be negative", number, m->vertex_count); return; }
    if (m->vertex_count > 0 && !sbl__stream_present(&m->positions))
        SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_MESH, "mesh %d: positions are missing (data and gl_buffer are both 0) for vertex_count %d", number, m->vertex_count);
    sbl__check_stream(check, gl, number, "positions", &m->positions, 3, m->vertex_count, 0);
    sbl__check_stream(check, gl, number, "normals", &m->normals, 3, m->vertex_count, 0);
    sbl__check_stream(check, gl, number, "texcoords", &m->texcoords, 2, m->vertex_count, 0);
    sbl__check_stream(check, gl, number, "colors", &m->colors, 4, m->vertex_count, 0);
    if (sbl__stream_present(&m->indices)) {
        if (m->index_count < 0 || m->index_count % 3 != 0)
            SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_MESH, "mesh %d: index_count is %d; it must be a multiple of 3", number, m->index_count);
        else sbl__check_stream(check, gl, number, "indices", &m->indices, 1, m->index_count, 1);
    } else if (m->vertex_count % 3 != 0)
        SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_MESH, "mesh %d: vertex_count is %d; without indices it must be a multiple of 3", number, m->vertex_count);
    sbl__check_transform(check, number, m->transform);
    if (m->material < 0 || m->material >= desc->material_count)
        SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_MESH, "mesh %d: material is %d; the scene has %d", number, m->material, desc->material_count);
}

static void sbl__check_material(sbl__check *check, const sbl_scene_desc *desc, int number) {
    const sbl_material *m = &desc->materials[number];
    int i;
    for (i = 0; i < 3; i++) {
        if (!(m->albedo[i] >= 0.0f && m->albedo[i] <= 1.0f))
            SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_MATERIAL, "material %d: albedo[%d] is %g; it must be 0 to 1", number, i, (double)m->albedo[i]);
        if (!(m->emission[i] >= 0.0f && sbl__finite(m->emission[i])))
            SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_MATERIAL, "material %d: emission[%d] is %g; it must be finite and not negative", number, i, (double)m->emission[i]);
    }
    if (m->albedo_texture < 0 || m->albedo_texture > desc->texture_count)
        SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_MATERIAL, "material %d: albedo_texture is %d; it must be 0 (none) to %d", number, m->albedo_texture, desc->texture_count);
    if (m->emission_texture < 0 || m->emission_texture > desc->texture_count)
        SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_MATERIAL, "material %d: emission_texture is %d; it must be 0 (none) to %d", number, m->emission_texture, desc->texture_count);
    if (!(m->alpha_cutoff >= 0.0f && m->alpha_cutoff <= 1.0f))
        SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_MATERIAL, "material %d: alpha_cutoff is %g; it must be 0 to 1", number, (double)m->alpha_cutoff);
    if (m->flags & ~(uint32_t)SBL_MATERIAL_FLAGS_ALL)
        SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_MATERIAL, "material %d: flags is 0x%x; only the bits 0x%x exist", number, m->flags, (unsigned)SBL_MATERIAL_FLAGS_ALL);
}

#define SBL__CONE(light) ((light)->cone > 0.0f ? (light)->cone : 90.0f)
#define SBL__MAX_SKY 16384  /* texels across the environment's picture: lamps keep 15 bits for each coordinate */

static int sbl__texture_channels(const sbl_texture *t) { return t->channels ? t->channels : 4; }
static size_t sbl__texture_texel(const sbl_texture *t) { return (size_t)sbl__texture_channels(t) * (t->format == SBL_PIXELS_FLOAT ? 4u : 1u); }

static void sbl__check_texture(sbl__check *check, const sbl__gl *gl, const sbl_scene_desc *desc, int index) {
    const sbl_texture *t = &desc->textures[index];
    int number = index + 1;  /* as materials count them */
    if ((int)t->format < 0 || (int)t->format >= SBL_PIXEL_FORMAT_COUNT) {
        SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_TEXTURE, "texture %d: format is %d; it must be 0 to %d", number, (int)t->format, SBL_PIXEL_FORMAT_COUNT - 1);
        return;
    }
    if ((int)t->wrap < 0 || (int)t->wrap >= SBL_WRAP_COUNT)
        SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_TEXTURE, "texture %d: wrap is %d; it must be 0 to %d", number, (int)t->wrap, SBL_WRAP_COUNT - 1);
    if (t->pixels && t->gl_texture)
        SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_TEXTURE, "texture %d: pixels and gl_texture (%u) are both set; give one", number, t->gl_texture);
    else if (!t->pixels && !t->gl_texture)
        SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_TEXTURE, "texture %d: pixels and gl_texture are both 0; a texture needs pixels", number);
    else if (t->gl_texture) {
        if (!gl->IsTexture(t->gl_texture))
            SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_TEXTURE, "texture %d: gl_texture %u is not a texture of the current GL context", number, t->gl_texture);
        return;
    }
    if (t->channels < 0 || t->channels > 4)
        SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_TEXTURE, "texture %d: channels is %d; it must be 1 to 4, or 0 for 4", number, t->channels);
    if (t->width < 1 || t->height < 1 || t->width > 65536 || t->height > 65536)
        SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_TEXTURE, "texture %d: size is %d x %d; both must be 1 to 65536", number, t->width, t->height);
    else if (t->channels >= 0 && t->channels <= 4 && t->stride && t->stride < (size_t)t->width * sbl__texture_texel(t))
        SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_TEXTURE, "texture %d: stride is %.0f, less than a row's %.0f bytes", number, (double)t->stride, (double)t->width * (double)sbl__texture_texel(t));
    else if (t->stride > SIZE_MAX / 4 / (size_t)t->height)
        SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_TEXTURE, "texture %d: stride is %.0f; %d rows of it reach past the address space", number, (double)t->stride, t->height);
}

static void sbl__check_light(sbl__check *check, const sbl_light *l, int number) {
    const int near = l->kind != SBL_LIGHT_DIRECTIONAL;
    int k;
    if ((int)l->kind < 0 || (int)l->kind >= SBL_LIGHT_KIND_COUNT) {
        SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_LIGHT, "light %d: kind is %d; it must be 0 to %d", number, (int)l->kind, SBL_LIGHT_KIND_COUNT - 1);
        return;
    }
    for (k = 0; k < 3; k++)
        if (!(l->intensity[k] >= 0.0f && sbl__finite(l->intensity[k])))
            SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_LIGHT, "light %d: intensity[%d] is %g; it must be finite and not negative", number, k, (double)l->intensity[k]);
    for (k = 0; near && k < 3; k++)
        if (!sbl__finite(l->position[k])) SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_LIGHT, "light %d: position[%d] is %g; it must be finite", number, k, (double)l->position[k]);
    if (l->kind != SBL_LIGHT_POINT) {
        for (k = 0; k < 3; k++)
            if (!sbl__finite(l->direction[k])) SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_LIGHT, "light %d: direction[%d] is %g; it must be finite", number, k, (double)l->direction[k]);
        if (sbl__all_zero(l->direction, 3)) SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_LIGHT, "light %d: direction is 0 0 0; it must point the way the light goes", number);
    }
    if (near && !(l->radius >= 0.0f && sbl__finite(l->radius)))
        SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_LIGHT, "light %d: radius is %g; it must be finite and not negative", number, (double)l->radius);
    if (!near && !(l->angle >= 0.0f && l->angle <= 180.0f))
        SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_LIGHT, "light %d: angle is %g; it must be 0 to 180 degrees", number, (double)l->angle);
    if (l->kind == SBL_LIGHT_SPOT) {
        if (!(l->cone >= 0.0f && l->cone <= 180.0f)) SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_LIGHT, "light %d: cone is %g; it must be 0 to 180 degrees", number, (double)l->cone);
        else if (!(l->inner_cone >= 0.0f && l->inner_cone <= SBL__CONE(l)))
            SBL__MISTAKE(check, SBL_LOG_ITEM_INVALID_LIGHT, "light %d: inner_cone is %g; it must be 0 to the cone's %g degrees", number, (double)l->inner_cone, (double)SBL__CONE(l));
    }
}

static void sbl__check_environment(sbl__check *check, const sbl_environment *e) {
    const sbl_texture *t = &e->picture;
    const sbl_log_item item = SBL_LOG_ITEM_INVALID_LIGHT;
    int k;
    if (t->gl_texture) SBL__MISTAKE(check, item, "environment: picture.gl_texture is %u; give pixels in client memory", t->gl_texture);
    if (t->pixels && e->radiance) SBL__MISTAKE(check, item, "environment: picture.pixels and radiance are both set; give one");
    if ((int)t->format < 0 || (int)t->format >= SBL_PIXEL_FORMAT_COUNT)
        SBL__MISTAKE(check, item, "environment: picture.format is %d; it must be 0 to %d", (int)t->format, SBL_PIXEL_FORMAT_COUNT - 1);
    else if (t->channels < 0 || t->channels > 4) SBL__MISTAKE(check, item, "environment: picture.channels is %d; it must be 1 to 4, or 0 for 4", t->channels);
    else if (t->pixels || t->width || t->height) {
        if (!t->pixels && !e->radiance)
            SBL__MISTAKE(check, item, "environment: picture.pixels and radiance are NULL, the picture's size is %d x %d; give pixels or a function", t->width, t->height);
        if (t->width < 1 || t->height < 1 || t->width > SBL__MAX_SKY || t->height > SBL__MAX_SKY)
            SBL__MISTAKE(check, item, "environment: picture is %d x %d; both must be 1 to %d", t->width, t->height, SBL__MAX_SKY);
        else if (t->stride && t->stride < (size_t)t->width * sbl__texture_texel(t))
            SBL__MISTAKE(check, item, "environment: picture.stride is %.0f, less than a row's %.0f bytes", (double)t->stride, (double)t->width * (double)sbl__texture_texel(t));
        else if (t->stride > SIZE_MAX / 4 / (size_t)t->height)
            SBL__MISTAKE(check, item, "environment: picture.stride is %.0f; %d rows of it reach past the address space", (double)t->stride, t->height);
    }
    if (!(e->scale >= 0.0f && sbl__finite(e->scale))) SBL__MISTAKE(check, item, "environment: scale is %g; it must be finite and not negative", (double)e->scale);
    if (!sbl__finite(e->rotation)) SBL__MISTAKE(check, item, "environment: rotation is %g; it must be finite", (double)e->rotation);
    for (k = 0; k < 3; k++)
        if (!sbl__finite(e->up[k])) SBL__MISTAKE(check, item, "environment: up[%d] is %g; it must be finite", k, (double)e->up[k]);
}

static sbl_result sbl__check_scene(const sbl__gl *gl, const sbl_scene_desc *desc) {
    sbl__check check;
    int i, k;
    check.base = gl->base;
    check.mistakes = 0;
    if (!SBL__CANARY_OK(desc)) {
        SBL__MISTAKE(&check, SBL_LOG_ITEM_INVALID_SCENE_DESC, "sbl_scene_desc: start_canary is 0x%x, end_canary 0x%x; zero the whole struct before use", desc->start_canary, desc->end_canary);
        return SBL_ERROR_INVALID_ARGUMENT;
    }
    if (desc->mesh_count < 0 || (desc->mesh_count > 0 && !desc->meshes))
        SBL__MISTAKE(&check, SBL_LOG_ITEM_INVALID_SCENE_DESC, "sbl_scene_desc: mesh_count is %d with meshes %s", desc->mesh_count, desc->meshes ? "given" : "NULL");
    if (desc->material_count < 0 || (desc->material_count > 0 && !desc->materials))
        SBL__MISTAKE(&check, SBL_LOG_ITEM_INVALID_SCENE_DESC, "sbl_scene_desc: material_count is %d with materials %s", desc->material_count, desc->materials ? "given" : "NULL");
    if (desc->texture_count < 0 || (desc->texture_count > 0 && !desc->textures))
        SBL__MISTAKE(&check, SBL_LOG_ITEM_INVALID_SCENE_DESC, "sbl_scene_desc: texture_count is %d with textures %s", desc->texture_count, desc->textures ? "given" : "NULL");
    for (i = 0; i < 3; i++)
        if (!(desc->sky[i] >= 0.0f && sbl__finite(desc->sky[i])))
            SBL__MISTAKE(&check, SBL_LOG_ITEM_INVALID_SCENE_DESC, "sbl_scene_desc: sky[%d] is %g; it must be finite and not negative", i, (double)desc->sky[i]);
    if (desc->draw)
        for (i = 0; i < 2; i++)
            for (k = 0; k < 3; k++)
                if (!sbl__finite(desc->draw_bounds[i][k]) || desc->draw_bounds[0][k] > desc->draw_bounds[1][k])
                    SBL__MISTAKE(&check, SBL_LOG_ITEM_INVALID_SCENE_DESC, "sbl_scene_desc: draw_bounds[%d][%d] is %g; bounds must be finite, lowest corner first", i, k, (double)desc->draw_bounds[i][k]);
    if (!(desc->draw_max_radiance >= 0.0f && sbl__finite(desc->draw_max_radiance)))
        SBL__MISTAKE(&check, SBL_LOG_ITEM_INVALID_SCENE_DESC, "sbl_scene_desc: draw_max_radiance is %g; it must be finite and not negative", (double)desc->draw_max_radiance);
    if (desc->light_count < 0 || (desc->light_count > 0 && !desc->lights))
        SBL__MISTAKE(&check, SBL_LOG_ITEM_INVALID_SCENE_DESC, "sbl_scene_desc: light_count is %d with lights %s", desc->light_count, desc->lights ? "given" : "NULL");
    for (i = 0; desc->lights && i < desc->light_count; i++) sbl__check_light(&check, &desc->lights[i], i);
    sbl__check_environment(&check, &desc->environment);
    for (i = 0; desc->meshes && i < desc->mesh_count; i++) sbl__check_mesh(&check, gl, desc, i);
    for (i = 0; desc->materials && i < desc->material_count; i++) sbl__check_material(&check, desc, i);
    for (i = 0; desc->textures && i < desc->texture_count; i++) sbl__check_texture(&check, gl, desc, i);
    return check.mistakes ? SBL_ERROR_INVALID_ARGUMENT : SBL_SUCCESS;
}

static void sbl__scene_free(const sbl__gl *gl, sbl__scene *s) {
    sbl__free(gl->base, s->meshes);
    sbl__free(gl->base, s->positions);
    sbl__free(gl->base, s->normals);
    sbl__free(gl->base, s->vertices);
    sbl__free(gl->base, s->attributes);
    sbl__free(gl->base, s->indices);
    sbl__free(gl->base, s->objects);
    sbl__name_delete(gl->DeleteVertexArrays, &s->vertex_array);
    sbl__texture_delete(gl, &s->position_texels);
    sbl__texture_delete(gl, &s->attribute_texels);
    sbl__texture_delete(gl, &s->index_texels);
    sbl__texture_delete(gl, &s->object_texels);
    sbl__buffer_delete(gl, &s->position_buffer);
    sbl__buffer_delete(gl, &s->attribute_buffer);
    sbl__buffer_delete(gl, &s->index_buffer);
    sbl__buffer_delete(gl, &s->object_buffer);
    sbl__texture_delete(gl, &s->texels_srgb);
    sbl__texture_delete(gl, &s->texels_float);
    sbl__free(gl->base, s->bvh.nodes);
    sbl__free(gl->base, s->bvh.order);
    sbl__texture_delete(gl, &s->node_texels);
    sbl__texture_delete(gl, &s->triangle_texels);
    sbl__free(gl->base, s->lights);
    sbl__free(gl->base, s->sky_pixels);
    sbl__texture_delete(gl, &s->sky_texels);
    sbl__texture_delete(gl, &s->lamp_texels);
    sbl__buffer_delete(gl, &s->lamp_buffer);
    sbl__buffer_delete(gl, &s->node_buffer);
    sbl__buffer_delete(gl, &s->triangle_buffer);
    memset(s, 0, sizeof *s);
}

/* Object to world for one mesh: positions, normals. Returns 0 where a vertex leaves the range of floats (logged). */
static int sbl__mesh_transform(const sbl__base *base, sbl__scene *s, int number, const float m[16]) {
    const sbl__mesh *mesh = &s->meshes[number];
    double n[9], d = sbl__affine_determinant(m);
    int v, i;
    /* normals go by the cofactors: the inverse transpose but for scale */
    n[0] = (double)m[5] * m[10] - (double)m[6] * m[9]; n[1] = (double)m[6] * m[8] - (double)m[4] * m[10]; n[2] = (double)m[4] * m[9] - (double)m[5] * m[8];
    n[3] = (double)m[9] * m[2] - (double)m[10] * m[1]; n[4] = (double)m[10] * m[0] - (double)m[8] * m[2]; n[5] = (double)m[8] * m[1] - (double)m[9] * m[0];
    n[6] = (double)m[1] * m[6] - (double)m[2] * m[5]; n[7] = (double)m[2] * m[4] - (double)m[0] * m[6]; n[8] = (double)m[0] * m[5] - (double)m[1] * m[4];
    for (v = mesh->first_vertex; v < mesh->first_vertex + mesh->vertex_count; v++) {
        const float *p = s->positions + 3 * (size_t)v, *q = s->normals + 3 * (size_t)v;
        double normal[3];
        for (i = 0; i < 3; i++) {
            s->vertices[v].position[i] = (float)((double)m[i] * p[0] + (double)m[4 + i] * p[1] + (double)m[8 + i] * p[2] + m[12 + i]);
            normal[i] = n[i] * q[0] + n[3 + i] * q[1] + n[6 + i] * q[2];
            if (d < 0) normal[i] = -normal[i];
        }
        if (!(fabs((double)s->vertices[v].position[0]) < 1e18 && fabs((double)s->vertices[v].position[1]) < 1e18 && fabs((double)s->vertices[v].position[2]) < 1e18)) {
            sbl__log(base, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_MESH, "mesh %d: vertex %d stands at %g %g %g in the world; coordinates must stay below 1e18", number,
                     v - mesh->first_vertex, (double)s->vertices[v].position[0], (double)s->vertices[v].position[1], (double)s->vertices[v].position[2]);
            return 0;
        }
        if (!sbl__normalize(normal)) normal[0] = normal[1] = normal[2] = 0;  /* no normal: flat */
        for (i = 0; i < 3; i++) s->attributes[v].normal[i] = (float)normal[i];
    }
    return 1;
}

/* One mesh into the scene's arrays. Triangles without area are left out. */
static sbl_result sbl__scene_add_mesh(const sbl__gl *gl, sbl__scene *s, const sbl_mesh *in, int number, int *degenerate) {
    sbl__mesh *mesh = &s->meshes[number];
    sbl__reader positions, normals, texcoords, colors, indices;
    int v, i, t, indexed = sbl__stream_present(&in->indices), count = indexed ? in->index_count : in->vertex_count;
    int bad = 0, first_vertex = s->vertex_count;
    sbl_result result;
    memset(&normals, 0, sizeof normals); memset(&texcoords, 0, sizeof texcoords); memset(&colors, 0, sizeof colors); memset(&indices, 0, sizeof indices);
    result = sbl__reader_open(gl, &positions, &in->positions, 3, in->vertex_count);
    if (result == SBL_SUCCESS) result = sbl__reader_open(gl, &normals, &in->normals, 3, in->vertex_count);
    if (result == SBL_SUCCESS) result = sbl__reader_open(gl, &texcoords, &in->texcoords, 2, in->vertex_count);
    if (result == SBL_SUCCESS) result = sbl__reader_open(gl, &colors, &in->colors, 4, in->vertex_count);
    if (result == SBL_SUCCESS && indexed) result = sbl__reader_open(gl, &indices, &in->indices, 1, count);
    mesh->first_vertex = first_vertex;
    mesh->vertex_count = in->vertex_count;
    mesh->first_triangle = s->triangle_count;
    if (sbl__all_zero(in->transform, 16)) sbl__identity(mesh->transform);
    else memcpy(mesh->transform, in->transform, sizeof mesh->transform);

    for (v = 0; result == SBL_SUCCESS && v < in->vertex_count && bad < 1; v++) {
        sbl__attribute *a = &s->attributes[first_vertex + v];
        float *p = s->positions + 3 * (size_t)(first_vertex + v), color[4];
        sbl__read_element(&positions, v, 3, p);
        if (!sbl__all_finite(p, 3)) {
            bad++;
            sbl__log(gl->base, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_MESH, "mesh %d: positions: vertex %d is %g %g %g; it must be finite", number, v, (double)p[0], (double)p[1], (double)p[2]);
        }
        if (normals.bytes) {
            float *n = s->normals + 3 * (size_t)(first_vertex + v);
            sbl__read_element(&normals, v, 3, n);
            if (!sbl__all_finite(n, 3)) {
                bad++;
                sbl__log(gl->base, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_MESH, "mesh %d: normals: vertex %d is %g %g %g; it must be finite", number, v, (double)n[0], (double)n[1], (double)n[2]);
            }
        }
        if (texcoords.bytes) {
            sbl__read_element(&texcoords, v, 2, a->uv);
            if (!sbl__all_finite(a->uv, 2)) {
                bad++;
                sbl__log(gl->base, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_MESH, "mesh %d: texcoords: vertex %d is %g %g; it must be finite", number, v, (double)a->uv[0], (double)a->uv[1]);
            }
        }
        for (i = 0; i < 4; i++) color[i] = 1;
        if (colors.bytes) sbl__read_element(&colors, v, 4, color);
        for (i = 0; i < 4; i++) {
            if (!(color[i] >= 0.0f && color[i] <= 1.0f)) {
                bad++;
                sbl__log(gl->base, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_MESH, "mesh %d: colors: component %d of vertex %d is %g; it must be 0 to 1", number, i, v, (double)color[i]);
                break;
            }
            a->color[i] = (uint16_t)(color[i] * 65535.0f + 0.5f);
        }
        s->vertices[first_vertex + v].object = (uint32_t)number;
    }
    if (colors.bytes) s->textured = 1;

    for (t = 0; result == SBL_SUCCESS && !bad && t < count / 3; t++) {
        uint32_t corner[3];
        const float *p[3];
        double e1[3], e2[3], c[3];
        for (i = 0; i < 3; i++) {
            corner[i] = indexed ? sbl__index(indices.bytes + indices.stride * (size_t)(3 * t + i), indices.type) : (uint32_t)(3 * t + i);
            if (corner[i] >= (uint32_t)in->vertex_count) {
                bad++;
                sbl__log(gl->base, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_MESH, "mesh %d: indices: index %d is %u; the mesh has %d vertices", number, 3 * t + i, corner[i], in->vertex_count);
                break;
            }
            p[i] = s->positions + 3 * ((size_t)first_vertex + corner[i]);
        }
        if (bad) break;
        for (i = 0; i < 3; i++) { e1[i] = (double)p[1][i] - p[0][i]; e2[i] = (double)p[2][i] - p[0][i]; }
        c[0] = e1[1] * e2[2] - e1[2] * e2[1]; c[1] = e1[2] * e2[0] - e1[0] * e2[2]; c[2] = e1[0] * e2[1] - e1[1] * e2[0];
        if (c[0] == 0 && c[1] == 0 && c[2] == 0) { (*degenerate)++; continue; }
        for (i = 0; i < 3; i++) s->indices[3 * (size_t)s->triangle_count + (size_t)i] = (uint32_t)first_vertex + corner[i];
        s->triangle_count++;
    }
    mesh->triangle_count = s->triangle_count - mesh->first_triangle;
    s->vertex_count += in->vertex_count;
    if (result == SBL_SUCCESS && !bad) {
        if (sbl__affine_determinant(mesh->transform) < 0)  /* a mirror turns the corners round: turn them back, so that the front stays the front */
            for (t = mesh->first_triangle; t < s->triangle_count; t++) {
                uint32_t swap = s->indices[3 * (size_t)t + 1];
                s->indices[3 * (size_t)t + 1] = s->indices[3 * (size_t)t + 2];
                s->indices[3 * (size_t)t + 2] = swap;
            }
        bad = !sbl__mesh_transform(gl->base, s, number, mesh->transform);
    }
    sbl__reader_close(gl, &positions);
    sbl__reader_close(gl, &normals);
    sbl__reader_close(gl, &texcoords);
    sbl__reader_close(gl, &colors);
    sbl__reader_close(gl, &indices);
    return result == SBL_SUCCESS && bad ? SBL_ERROR_INVALID_ARGUMENT : result;
}

static void sbl__scene_measure(sbl__scene *s) {
    double diagonal = 0, farthest = 0;
    int i, v, k, any = 0;
    for (k = 0; k < 3; k++) { s->bounds[0][k] = FLT_MAX; s->bounds[1][k] = -FLT_MAX; }
    for (i = 0; i < 3 * s->triangle_count; i++) {
        v = (int)s->indices[i];
        for (k = 0; k < 3; k++) {
            s->bounds[0][k] = SBL__MIN(s->bounds[0][k], s->vertices[v].position[k]);
            s->bounds[1][k] = SBL__MAX(s->bounds[1][k], s->vertices[v].position[k]);
        }
        any = 1;
    }
    if (s->draw) {
        for (k = 0; k < 3; k++) {
            s->bounds[0][k] = SBL__MIN(s->bounds[0][k], s->draw_bounds[0][k]);
            s->bounds[1][k] = SBL__MAX(s->bounds[1][k], s->draw_bounds[1][k]);
        }
        any = 1;
    }
    if (!any) memset(s->bounds, 0, sizeof s->bounds);
    for (k = 0; k < 3; k++) {
        double side = (double)s->bounds[1][k] - s->bounds[0][k];
        diagonal += side * side;
        farthest = SBL__MAX(farthest, SBL__MAX(fabs((double)s->bounds[0][k]), fabs((double)s->bounds[1][k])));
    }
    s->extent = (float)(sqrt(diagonal) + farthest);
    if (!(s->extent > 0)) s->extent = 1;
}

static sbl_result sbl__scene_texels_make(const sbl__gl *gl, sbl__scene *s) {
    sbl_result result = sbl__texels_make(gl, &s->position_texels, SBL__GL_RGBA32UI, &s->position_buffer, s->wide, "making the positions' texture");
    if (result == SBL_SUCCESS) result = sbl__texels_make(gl, &s->attribute_texels, SBL__GL_RGBA32UI, &s->attribute_buffer, s->wide, "making the attributes' texture");
    if (result == SBL_SUCCESS) result = sbl__texels_make(gl, &s->index_texels, SBL__GL_R32UI, &s->index_buffer, s->wide, "making the indices' texture");
    if (result == SBL_SUCCESS) result = sbl__texels_make(gl, &s->object_texels, SBL__GL_RGBA32UI, &s->object_buffer, s->wide, "making the objects' texture");
    return result;
}

static sbl_result sbl__scene_upload(const sbl__gl *gl, sbl__scene *s) {
    const sbl_capabilities *c = &gl->capabilities;
    double texels = SBL__MAX(SBL__MAX(3.0 * s->triangle_count + 8, 2.0 * s->vertex_count), SBL__OBJECT_WORDS / 4 * (double)s->mesh_count);  /* the hierarchy's are fewer */
    double lamps = s->light_count;
    int i;
    for (i = 0; i < s->mesh_count; i++)
        if (s->objects[SBL__OBJECT_WORDS * (size_t)i + 4] | s->objects[SBL__OBJECT_WORDS * (size_t)i + 5] | s->objects[SBL__OBJECT_WORDS * (size_t)i + 6]) lamps += s->meshes[i].triangle_count;
    for (i = 0; s->sky_pixels && i < s->sky_width * s->sky_height; i++) lamps += sbl__max3(s->sky_pixels + 3 * (size_t)i) > s->sky_limit;
    texels = SBL__MAX(texels, 9 * lamps + 3.0 * s->light_count);  /* two nodes and a leaf each */
    double most = c->max_texture_size < SBL__TEXELS_ACROSS ? 0 : (c->max_texture_size - 1) * (double)SBL__TEXELS_ACROSS;
    sbl_result result;
    s->wide = texels > c->max_texture_buffer_size;
    if (s->wide && texels > most) {
        sbl__log(gl->base, SBL_LOG_ERROR, SBL_LOG_ITEM_TOO_LARGE, "the scene has %d vertices, %d triangles and %d meshes; this driver's textures hold %.0f, %.0f and %.0f", s->vertex_count,
                 s->triangle_count, s->mesh_count, SBL__MAX(most, c->max_texture_buffer_size) / 2, SBL__MAX(most, c->max_texture_buffer_size) / 3, SBL__MAX(most, c->max_texture_buffer_size) / 5);
        return SBL_ERROR_UNSUPPORTED;
    }
    gl->BindVertexArray(0);
    result = sbl__buffer_make(gl, &s->position_buffer, sizeof(sbl__vertex) * (size_t)s->vertex_count, s->vertices, SBL__GL_STATIC_DRAW, "storing positions");
    if (result == SBL_SUCCESS) result = sbl__buffer_make(gl, &s->attribute_buffer, sizeof(sbl__attribute) * (size_t)s->vertex_count, s->attributes, SBL__GL_STATIC_DRAW, "storing attributes");
    if (result == SBL_SUCCESS) result = sbl__buffer_make(gl, &s->index_buffer, 12 * (size_t)s->triangle_count, s->indices, SBL__GL_STATIC_DRAW, "storing indices");
    if (result == SBL_SUCCESS) result = sbl__buffer_make(gl, &s->object_buffer, 4 * SBL__OBJECT_WORDS * (size_t)s->mesh_count, s->objects, SBL__GL_STATIC_DRAW, "storing objects");
    if (result == SBL_SUCCESS) result = sbl__scene_texels_make(gl, s);
    if (result != SBL_SUCCESS) return result;
    if (!s->vertex_array) s->vertex_array = sbl__name_make(gl, gl->GenVertexArrays, "making the scene's vertex array");
    if (!s->vertex_array) return SBL_ERROR_GL;
    gl->BindVertexArray(s->vertex_array);
    gl->BindBuffer(SBL__GL_ELEMENT_ARRAY_BUFFER, s->index_buffer.id);
    gl->BindBuffer(SBL__GL_ARRAY_BUFFER, s->position_buffer.id);
    gl->VertexAttribPointer(0, 3, SBL__GL_FLOAT, 0, (int)sizeof(sbl__vertex), (const void *)0);
    gl->VertexAttribIPointer(1, 1, SBL__GL_UNSIGNED_INT, (int)sizeof(sbl__vertex), (const void *)offsetof(sbl__vertex, object));
    gl->BindBuffer(SBL__GL_ARRAY_BUFFER, s->attribute_buffer.id);
    gl->VertexAttribPointer(2, 2, SBL__GL_FLOAT, 0, (int)sizeof(sbl__attribute), (const void *)offsetof(sbl__attribute, uv));
    gl->VertexAttribPointer(3, 4, SBL__GL_UNSIGNED_SHORT, 1, (int)sizeof(sbl__attribute), (const void *)offsetof(sbl__attribute, color));
    gl->EnableVertexAttribArray(0);
    gl->EnableVertexAttribArray(1);
    gl->EnableVertexAttribArray(2);
    gl->EnableVertexAttribArray(3);
    gl->BindVertexArray(0);
    return sbl__gl_check(gl, "making the scene's vertex array");
}

/* Texels of all textures of one kind stand in one GL texture, each texture from a row of its own on. */
typedef struct sbl__texel_store { unsigned char *bytes; size_t texel; int width, rows, is_float; } sbl__texel_store;

static void sbl__store_texel(const sbl__texel_store *store, size_t at, const float rgba[4]) {
    int i;
    if (store->is_float) {
        uint16_t half[4];
        for (i = 0; i < 4; i++) half[i] = sbl__to_half(rgba[i]);
        memcpy(store->bytes + 8 * at, half, 8);
    } else
        for (i = 0; i < 4; i++) {
            float x = i < 3 ? sbl__linear_to_srgb(rgba[i]) : rgba[i];
            store->bytes[4 * at + (size_t)i] = (unsigned char)(255.0f * SBL__MIN(SBL__MAX(x, 0.0f), 1.0f) + 0.5f);
        }
}

/* The GL textures that desc names, read through a shader as sampling gives them: 4 floats a texel. The caller frees *out. */
static sbl_result sbl__read_gl_texture(const sbl__gl *gl, unsigned copy_program, unsigned empty_array, unsigned name, int width, int height, float **out) {
    sbl__texture target;
    const sbl__texture *colors[1];
    unsigned framebuffer = 0, sampler = 0;
    sbl_result result;
    memset(&target, 0, sizeof target);
    colors[0] = &target;
    *out = (float *)sbl__alloc(gl->base, (size_t)width * (size_t)height, 16);
    if (!*out) return SBL_ERROR_OUT_OF_MEMORY;
    result = sbl__texture_make(gl, &target, width, height, SBL__GL_RGBA32F, NULL, "reading a GL texture");
    if (result == SBL_SUCCESS) result = sbl__framebuffer_make(gl, &framebuffer, colors, 1, NULL, "reading a GL texture");
    if (result == SBL_SUCCESS) {
        gl->UseProgram(copy_program);
        sbl__bind(gl, copy_program, "source", 0, SBL__GL_TEXTURE_2D, name);
        /* a sampler of its own makes the texture complete where it has level 0 only and GL's default filter, which asks for mip maps */
        sampler = sbl__name_make(gl, gl->GenSamplers, "reading a GL texture");
        if (sampler) {
            gl->SamplerParameteri(sampler, SBL__GL_TEXTURE_MIN_FILTER, SBL__GL_NEAREST);
            gl->SamplerParameteri(sampler, SBL__GL_TEXTURE_MAG_FILTER, SBL__GL_NEAREST);
            gl->BindSampler(0, sampler);
        }
        gl->BindVertexArray(empty_array);
        gl->Disable(SBL__GL_DEPTH_TEST);
        gl->Viewport(0, 0, width, height);
        gl->DrawArrays(SBL__GL_TRIANGLES, 0, 3);
        result = sampler ? sbl__read_pixels(gl, framebuffer, 0, &target, height, *out, "reading a GL texture") : SBL_ERROR_GL;
        gl->BindSampler(0, 0);
        sbl__name_delete(gl->DeleteSamplers, &sampler);
    }
    sbl__name_delete(gl->DeleteFramebuffers, &framebuffer);
    sbl__texture_delete(gl, &target);
    if (result != SBL_SUCCESS) { sbl__free(gl->base, *out); *out = NULL; }
    return result;
}

/* Pixel x of a row as r g b a, bytes as 0 to 1. */
static void sbl__read_pixel(const sbl_texture *t, const unsigned char *row, int x, float c[4]) {
    const int channels = sbl__texture_channels(t);
    int k;
    row += (size_t)x * sbl__texture_texel(t);
    if (t->format == SBL_PIXELS_FLOAT) memcpy(c, row, 4 * (size_t)channels);
    else for (k = 0; k < channels; k++) c[k] = (float)row[k] / 255.0f;
    if (channels == 2) c[3] = c[1];
    if (channels < 3) c[1] = c[2] = c[0];
}

static sbl_result sbl__scene_add_textures(const sbl__gl *gl, sbl__scene *s, const sbl_scene_desc *desc, unsigned copy_program, unsigned empty_array, uint32_t (*records)[4], float *brightest) {
    sbl__texel_store stores[2];
    sbl_result result = SBL_SUCCESS;
    int i, k, x, y;
    memset(stores, 0, sizeof stores);
    stores[0].texel = 4;
    stores[1].texel = 8; stores[1].is_float = 1;
    for (k = 0; k < 2; k++) stores[k].width = SBL__MIN(SBL__TEXEL_STORE_WIDTH, gl->capabilities.max_texture_size);
    for (i = 0; i < desc->texture_count; i++) {
        const sbl_texture *t = &desc->textures[i];
        int width = t->width, height = t->height;
        sbl__texel_store *store = &stores[t->format != SBL_PIXELS_SRGB8];
        double rows;
        if (t->gl_texture) {
            gl->ActiveTexture(SBL__GL_TEXTURE0);
            gl->BindTexture(SBL__GL_TEXTURE_2D, t->gl_texture);
            gl->GetTexLevelParameteriv(SBL__GL_TEXTURE_2D, 0, SBL__GL_TEXTURE_WIDTH, &width);
            gl->GetTexLevelParameteriv(SBL__GL_TEXTURE_2D, 0, SBL__GL_TEXTURE_HEIGHT, &height);
            result = sbl__gl_check(gl, "looking at a GL texture");
            if (result == SBL_ERROR_OUT_OF_MEMORY) return result;
            if (result != SBL_SUCCESS || width < 1 || height < 1) {
                sbl__log(gl->base, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_TEXTURE, "texture %d: gl_texture %u is not a GL_TEXTURE_2D with pixels in level 0", i + 1, t->gl_texture);
                return SBL_ERROR_INVALID_ARGUMENT;
            }
        }
        rows = ceil((double)width * height / store->width);
        if (store->rows + rows > gl->capabilities.max_texture_size) {
            sbl__log(gl->base, SBL_LOG_ERROR, SBL_LOG_ITEM_TOO_LARGE, "texture %d: all textures together need more than %d x %d texels; use smaller ones", i + 1, store->width, gl->capabilities.max_texture_size);
            return SBL_ERROR_UNSUPPORTED;
        }
        records[i][0] = (uint32_t)store->rows;
        records[i][1] = (uint32_t)width;
        records[i][2] = (uint32_t)height;
        records[i][3] = (store->is_float ? 2u : 1u) | (t->wrap == SBL_WRAP_CLAMP ? 4u : 0u);
        store->rows += (int)rows;
    }
    for (k = 0; k < 2 && result == SBL_SUCCESS; k++) {
        if (!stores[k].rows) continue;
        stores[k].bytes = (unsigned char *)sbl__alloc(gl->base, (size_t)stores[k].rows * (size_t)stores[k].width, stores[k].texel);
        if (!stores[k].bytes) result = SBL_ERROR_OUT_OF_MEMORY;
    }
    for (i = 0; i < desc->texture_count && result == SBL_SUCCESS; i++) {
        const sbl_texture *t = &desc->textures[i];
        const sbl__texel_store *store = &stores[t->format != SBL_PIXELS_SRGB8];
        int width = (int)records[i][1], height = (int)records[i][2], channels = sbl__texture_channels(t);
        size_t at = (size_t)records[i][0] * (size_t)store->width, stride = t->stride ? t->stride : (size_t)t->width * sbl__texture_texel(t);
        float *copy = NULL, highest = 0;
        if (t->gl_texture) result = sbl__read_gl_texture(gl, copy_program, empty_array, t->gl_texture, width, height, &copy);
        for (y = 0; y < height && result == SBL_SUCCESS; y++)
            for (x = 0; x < width; x++, at++) {
                float c[4] = { 0, 0, 0, 1 };
                if (copy) memcpy(c, copy + 4 * ((size_t)y * (size_t)width + (size_t)x), sizeof c);
                else {
                    const unsigned char *row = (const unsigned char *)t->pixels + (size_t)y * stride;
                    if (t->format == SBL_PIXELS_SRGB8) {  /* bytes go as they are: GL decodes them */
                        const unsigned char *p = row + (size_t)channels * (size_t)x;
                        unsigned char *q = store->bytes + 4 * at;
                        q[0] = p[0];
                        q[1] = p[channels < 3 ? 0 : 1];
                        q[2] = p[channels < 3 ? 0 : 2];
                        q[3] = channels == 2 ? p[1] : channels == 4 ? p[3] : 255;
                        highest = 1;
                        continue;
                    } else sbl__read_pixel(t, row, x, c);
                }
                for (k = 0; k < 4; k++)
                    if (!(c[k] >= 0.0f && sbl__finite(c[k]))) {
                        sbl__log(gl->base, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_TEXTURE, "texture %d: component %d of pixel %d %d is %g; it must be finite and not negative", i + 1, k, x, y, (double)c[k]);
                        result = SBL_ERROR_INVALID_ARGUMENT;
                        x = width; k = 4;
                        break;
                    }
                if (result != SBL_SUCCESS) break;
                highest = SBL__MAX(highest, sbl__max3(c));
                sbl__store_texel(store, at, c);
            }
        brightest[i] = highest;
        sbl__free(gl->base, copy);
    }
    if (result == SBL_SUCCESS && stores[0].rows)
        result = sbl__texture_make(gl, &s->texels_srgb, stores[0].width, stores[0].rows, SBL__GL_SRGB8_ALPHA8, stores[0].bytes, "storing textures");
    if (result == SBL_SUCCESS && stores[1].rows)
        result = sbl__texture_make(gl, &s->texels_float, stores[1].width, stores[1].rows, SBL__GL_RGBA16F, stores[1].bytes, "storing textures");
    sbl__free(gl->base, stores[0].bytes);
    sbl__free(gl->base, stores[1].bytes);
    return result;
}

/* The direction of the middle of a texel of the environment's picture, as sky.glsl has it. */
static void sbl__sky_direction(const sbl__scene *s, int x, int y, double out[3]) {
    const double angle = SBL__PI * (y + 0.5) / s->sky_height, around = 2 * SBL__PI * ((x + 0.5) / s->sky_width - 0.5);
    int k;
    for (k = 0; k < 3; k++) out[k] = sin(angle) * (cos(around) * s->sky_axes[0][k] + sin(around) * s->sky_axes[2][k]) + cos(angle) * s->sky_axes[1][k];
}

/* The environment's picture as floats, on the CPU and on the GPU. */
static sbl_result sbl__scene_add_environment(const sbl__gl *gl, sbl__scene *s, const sbl_environment *e) {
    const sbl_texture *t = &e->picture;
    const int width = t->width ? t->width : 512, height = t->height ? t->height : 256;
    const size_t stride = t->stride ? t->stride : (size_t)width * sbl__texture_texel(t);
    const double turn = e->rotation * SBL__PI / 180;
    const float scale = e->scale > 0 ? e->scale : 1.0f;
    double up[3] = { 0, 1, 0 }, x[3], z[3], mean = 0, weights = 0;
    float *texels;
    int i, k, row;
    sbl_result result;
    if (!t->pixels && !e->radiance) return SBL_SUCCESS;
    if (width > gl->capabilities.max_texture_size || height > gl->capabilities.max_texture_size) {
        sbl__log(gl->base, SBL_LOG_ERROR, SBL_LOG_ITEM_TOO_LARGE, "environment: picture is %d x %d; this driver's textures are at most %d across", width, height, gl->capabilities.max_texture_size);
        return SBL_ERROR_UNSUPPORTED;
    }
    for (k = 0; k < 3 && !sbl__all_zero(e->up, 3); k++) up[k] = e->up[k];
    sbl__normalize(up);
    /* the shortest way from +y to up turns about their cross product; from -y, half a turn about x */
    x[0] = up[1] > -1 + 1e-9 ? 1 - up[0] * up[0] / (1 + up[1]) : 1;
    x[1] = up[1] > -1 + 1e-9 ? -up[0] : 0;
    x[2] = up[1] > -1 + 1e-9 ? -up[0] * up[2] / (1 + up[1]) : 0;
    z[0] = x[1] * up[2] - x[2] * up[1]; z[1] = x[2] * up[0] - x[0] * up[2]; z[2] = x[0] * up[1] - x[1] * up[0];
    for (k = 0; k < 3; k++) {
        s->sky_axes[0][k] = (float)(cos(turn) * x[k] - sin(turn) * z[k]);
        s->sky_axes[1][k] = (float)up[k];
        s->sky_axes[2][k] = (float)(sin(turn) * x[k] + cos(turn) * z[k]);
    }
    s->sky_width = width;
    s->sky_height = height;
    s->sky_pixels = (float *)sbl__alloc(gl->base, (size_t)width * (size_t)height, 12);
    texels = (float *)sbl__alloc(gl->base, (size_t)width * (size_t)height, 16);
    result = s->sky_pixels && texels ? SBL_SUCCESS : SBL_ERROR_OUT_OF_MEMORY;
    for (row = 0; row < height && result == SBL_SUCCESS; row++)
        for (i = 0; i < width; i++) {
            const size_t at = (size_t)row * (size_t)width + (size_t)i;
            const double weight = sin(SBL__PI * (row + 0.5) / height);
            float c[4] = { 0, 0, 0, 0 };
            if (e->radiance) {
                double exact[3];
                float direction[3];
                sbl__sky_direction(s, i, row, exact);
                for (k = 0; k < 3; k++) direction[k] = (float)exact[k];
                e->radiance(direction, c, e->user);
            } else {
                sbl__read_pixel(t, (const unsigned char *)t->pixels + (size_t)row * stride, i, c);
                for (k = 0; k < 3 && t->format == SBL_PIXELS_SRGB8; k++) c[k] = sbl__srgb_to_linear(c[k]);
            }
            for (k = 0; k < 3 && result == SBL_SUCCESS; k++) {
                c[k] *= scale;
                if (c[k] >= 0.0f && sbl__finite(c[k])) continue;
                sbl__log(gl->base, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_LIGHT, "environment: component %d of pixel %d %d is %g; it must be finite and not negative", k, i, row, (double)c[k]);
                result = SBL_ERROR_INVALID_ARGUMENT;
            }
            if (result != SBL_SUCCESS) break;
            memcpy(s->sky_pixels + 3 * at, c, 12);
            memcpy(texels + 4 * at, c, 16);
            mean += weight * sbl__max3(c);
            weights += weight;
            s->max_radiance = SBL__MAX(s->max_radiance, sbl__max3(c) + sbl__max3(s->sky));
        }
    if (result == SBL_SUCCESS) result = sbl__texture_make(gl, &s->sky_texels, width, height, SBL__GL_RGBA32F, texels, "storing the environment");
    sbl__free(gl->base, texels);
    s->sky_limit = (float)SBL__MIN(SBL__MAX(SBL__SKY_LIMIT * mean / weights, 1e-37), FLT_MAX);
    return result;
}

static sbl_result sbl__scene_add_lights(const sbl__gl *gl, sbl__scene *s, const sbl_scene_desc *desc) {
    const size_t bytes = (size_t)desc->light_count * sizeof(sbl_light);
    int i;
    s->light_count = desc->light_count;
    s->lights = (sbl_light *)sbl__alloc(gl->base, (size_t)desc->light_count, sizeof(sbl_light));
    if (!s->lights) return SBL_ERROR_OUT_OF_MEMORY;
    if (bytes) memcpy(s->lights, desc->lights, bytes);
    s->lamp_unit = s->max_radiance;
    for (i = 0; i < s->light_count; i++) {
        const sbl_light *l = &s->lights[i];
        double intensity = sbl__max3(l->intensity);
        s->lamp_unit = SBL__MAX(s->lamp_unit, (float)SBL__MIN(l->kind == SBL_LIGHT_DIRECTIONAL ? intensity : intensity / s->extent / s->extent, 1e37));
    }
    s->lamp_unit = SBL__MAX(s->lamp_unit, 1e-30f);
    return SBL_SUCCESS;
}

static sbl_result sbl__scene_make(const sbl__gl *gl, sbl__scene *s, const sbl_scene_desc *desc, unsigned copy_program, unsigned empty_array) {
    sbl_result result = sbl__check_scene(gl, desc);
    uint32_t (*records)[4];
    float *brightest;
    double vertices = 0, triangles = 0;
    int i, k, degenerate = 0;
    if (result != SBL_SUCCESS) return result;
    for (i = 0; i < desc->mesh_count; i++) {
        vertices += desc->meshes[i].vertex_count;
        triangles += (sbl__stream_present(&desc->meshes[i].indices) ? desc->meshes[i].index_count : desc->meshes[i].vertex_count) / 3;
    }
    if (vertices > INT_MAX / 4 || triangles > INT_MAX / 4) {
        sbl__log(gl->base, SBL_LOG_ERROR, SBL_LOG_ITEM_TOO_LARGE, "the scene has %.0f vertices and %.0f triangles; at most %d of each can be numbered", vertices, triangles, INT_MAX / 4);
        return SBL_ERROR_UNSUPPORTED;
    }
    s->mesh_count = desc->mesh_count;
    s->meshes = (sbl__mesh *)sbl__alloc(gl->base, (size_t)desc->mesh_count, sizeof(sbl__mesh));
    s->positions = (float *)sbl__alloc(gl->base, (size_t)vertices, 12);
    s->normals = (float *)sbl__alloc(gl->base, (size_t)vertices, 12);
    s->vertices = (sbl__vertex *)sbl__alloc(gl->base, (size_t)vertices, sizeof(sbl__vertex));
    s->attributes = (sbl__attribute *)sbl__alloc(gl->base, (size_t)vertices, sizeof(sbl__attribute));
    s->indices = (uint32_t *)sbl__alloc(gl->base, (size_t)triangles, 12);
    s->objects = (uint32_t *)sbl__alloc(gl->base, (size_t)desc->mesh_count, 4 * SBL__OBJECT_WORDS);
    records = (uint32_t (*)[4])sbl__alloc(gl->base, (size_t)desc->texture_count, sizeof *records);
    brightest = (float *)sbl__alloc(gl->base, (size_t)desc->texture_count, sizeof(float));
    if (!s->meshes || !s->positions || !s->normals || !s->vertices || !s->attributes || !s->indices || !s->objects || !records || !brightest) result = SBL_ERROR_OUT_OF_MEMORY;

    for (i = 0; i < desc->mesh_count && (result == SBL_SUCCESS || result == SBL_ERROR_INVALID_ARGUMENT); i++) {  /* all mistakes are reported, not only the first mesh's */
        sbl_result mesh = sbl__scene_add_mesh(gl, s, &desc->meshes[i], i, &degenerate);
        if (mesh != SBL_SUCCESS) result = mesh;
    }
    if (result == SBL_SUCCESS) result = sbl__scene_add_textures(gl, s, desc, copy_program, empty_array, records, brightest);
    if (result == SBL_SUCCESS) {
        memcpy(s->sky, desc->sky, sizeof s->sky);
        s->max_radiance = sbl__max3(s->sky);
        result = sbl__scene_add_environment(gl, s, &desc->environment);
    }
    if (result == SBL_SUCCESS) {
        s->draw = desc->draw;
        s->draw_user = desc->draw_user;
        memcpy(s->draw_bounds, desc->draw_bounds, sizeof s->draw_bounds);
        if (s->draw) s->max_radiance = SBL__MAX(s->max_radiance, desc->draw_max_radiance > 0 ? desc->draw_max_radiance : 1.0f);
        for (i = 0; i < desc->mesh_count; i++) {
            const sbl_mesh *mesh = &desc->meshes[i];
            const sbl_material *m = &desc->materials[mesh->material];
            uint32_t *words = s->objects + (size_t)SBL__OBJECT_WORDS * (size_t)i;
            float scale = m->emission_texture ? brightest[m->emission_texture - 1] : 1.0f;
            memcpy(words, m->albedo, 12);
            memcpy(words + 3, &m->alpha_cutoff, 4);
            memcpy(words + 4, m->emission, 12);
            words[7] = m->flags;
            for (k = 0; k < 4; k++) {
                words[8 + k] = m->albedo_texture ? records[m->albedo_texture - 1][k] : 0;
                words[12 + k] = m->emission_texture ? records[m->emission_texture - 1][k] : 0;
            }
            words[16] = mesh->id ? mesh->id : (uint32_t)i + 1;
            if (m->albedo_texture || m->emission_texture || m->alpha_cutoff > 0) s->textured = 1;
            s->max_radiance = SBL__MAX(s->max_radiance, scale * sbl__max3(m->emission));
        }
        sbl__scene_measure(s);
        result = sbl__scene_add_lights(gl, s, desc);
        if (degenerate)
            sbl__log(gl->base, SBL_LOG_WARNING, SBL_LOG_ITEM_DEGENERATE_TRIANGLES, "%d triangles without area were left out of %.0f", degenerate, triangles);
        if (result == SBL_SUCCESS) result = sbl__scene_upload(gl, s);
    }
    sbl__free(gl->base, records);
    sbl__free(gl->base, brightest);
    if (result != SBL_SUCCESS) sbl__scene_free(gl, s);
    return result;
}

/* Places a mesh in the arrays and on the GPU. */
static sbl_result sbl__scene_place(const sbl__gl *gl, sbl__scene *s, int number, const float transform[16]) {
    sbl__mesh *mesh = &s->meshes[number];
    int t, turned = (sbl__affine_determinant(mesh->transform) < 0) != (sbl__affine_determinant(transform) < 0);
    if (!sbl__mesh_transform(gl->base, s, number, transform)) return SBL_ERROR_INVALID_ARGUMENT;
    memcpy(mesh->transform, transform, sizeof mesh->transform);
    for (t = mesh->first_triangle; turned && t < mesh->first_triangle + mesh->triangle_count; t++) {
        uint32_t swap = s->indices[3 * (size_t)t + 1];
        s->indices[3 * (size_t)t + 1] = s->indices[3 * (size_t)t + 2];
        s->indices[3 * (size_t)t + 2] = swap;
    }
    s->bvh_ready = 0;
    sbl__scene_measure(s);
    gl->BindVertexArray(0);
    gl->BindBuffer(SBL__GL_ARRAY_BUFFER, s->position_buffer.id);
    gl->BufferSubData(SBL__GL_ARRAY_BUFFER, (ptrdiff_t)(sizeof(sbl__vertex) * (size_t)mesh->first_vertex), (ptrdiff_t)(sizeof(sbl__vertex) * (size_t)mesh->vertex_count), s->vertices + mesh->first_vertex);
    gl->BindBuffer(SBL__GL_ARRAY_BUFFER, s->attribute_buffer.id);
    gl->BufferSubData(SBL__GL_ARRAY_BUFFER, (ptrdiff_t)(sizeof(sbl__attribute) * (size_t)mesh->first_vertex), (ptrdiff_t)(sizeof(sbl__attribute) * (size_t)mesh->vertex_count), s->attributes + mesh->first_vertex);
    if (turned) {
        gl->BindBuffer(SBL__GL_ARRAY_BUFFER, s->index_buffer.id);
        gl->BufferSubData(SBL__GL_ARRAY_BUFFER, (ptrdiff_t)(12 * (size_t)mesh->first_triangle), (ptrdiff_t)(12 * (size_t)mesh->triangle_count), s->indices + 3 * (size_t)mesh->first_triangle);
    }
    return s->wide ? sbl__scene_texels_make(gl, s) : sbl__gl_check(gl, "moving a mesh");
}

static sbl_result sbl__scene_move(const sbl__gl *gl, sbl__scene *s, int number, const float transform[16]) {
    float identity[16], before[16];
    sbl_result result;
    sbl__identity(identity);
    memcpy(before, s->meshes[number].transform, sizeof before);
    result = sbl__scene_place(gl, s, number, sbl__all_zero(transform, 16) ? identity : transform);
    if (result != SBL_SUCCESS) sbl__scene_place(gl, s, number, before);
    return result;
}

/* Binds what scene.glsl and surface.glsl read to units 0 to 5. */
static void sbl__scene_bind(const sbl__gl *gl, const sbl__scene *s, unsigned program) {
    sbl__bind_texels(gl, program, "sbl_objects", 0, &s->object_texels);
    sbl__bind(gl, program, "sbl_texels_srgb", 1, SBL__GL_TEXTURE_2D, s->texels_srgb.id);
    sbl__bind(gl, program, "sbl_texels_float", 2, SBL__GL_TEXTURE_2D, s->texels_float.id);
    sbl__bind_texels(gl, program, "sbl_positions", 3, &s->position_texels);
    sbl__bind_texels(gl, program, "sbl_attributes", 4, &s->attribute_texels);
    sbl__bind_texels(gl, program, "sbl_indices", 5, &s->index_texels);
}

/* Binds what sky.glsl reads to a unit. */
static void sbl__sky_bind(const sbl__gl *gl, const sbl__scene *s, unsigned program, int unit) {
    sbl__bind(gl, program, "sky_picture", unit, SBL__GL_TEXTURE_2D, s->sky_texels.id);
    sbl__uniform_3(gl, program, "sky_x", s->sky_axes[0]);
    sbl__uniform_3(gl, program, "sky_up", s->sky_axes[1]);
    sbl__uniform_3(gl, program, "sky_z", s->sky_axes[2]);
    sbl__uniform_f(gl, program, "sky_limit", s->sky_limit);
    sbl__uniform_3(gl, program, "sky", s->sky);
}

/* ======================================================================================================== >>bvh
   A bounding volume hierarchy over the scene's triangles: binned surface-area heuristic (Wald 2007, "On fast Construction of SAH-based Bounding
   Volume Hierarchies"), boxes on a 16-bit grid over the scene, two texels a node; see traverse.glsl for the layout. */

#define SBL__BVH_BINS 16
#define SBL__BVH_LEAF 4          /* triangles in a leaf, at most 8 */
#define SBL__BVH_SAH_DEPTH 32    /* below it halves are split off by number, so that the depth stays under the stack's */
#define SBL__BVH_STACK 64
#define SBL__BVH_DROPPED 0xffffffffu  /* in the order: nothing stands here */
#define SBL__BVH_GRID_STEPS 512  /* boxes of fewer steps in all directions ... */
#define SBL__BVH_GRID_LEAST 32   /* and of as many triangles get a grid of their own */

typedef struct sbl__box { float low[3], high[3]; } sbl__box;

static void sbl__box_clear(sbl__box *b) {
    int k;
    for (k = 0; k < 3; k++) { b->low[k] = FLT_MAX; b->high[k] = -FLT_MAX; }
}

static void sbl__box_add(sbl__box *b, const sbl__box *other) {
    int k;
    for (k = 0; k < 3; k++) {
        b->low[k] = SBL__MIN(b->low[k], other->low[k]);
        b->high[k] = SBL__MAX(b->high[k], other->high[k]);
    }
}

static float sbl__box_area(const sbl__box *b) {
    float x = b->high[0] - b->low[0], y = b->high[1] - b->low[1], z = b->high[2] - b->low[2];
    return x < 0 ? 0 : x * y + y * z + z * x;
}

/* What boxes are written in steps of; where everything is small beside it, a finer one takes over (see traverse.glsl). */
typedef struct sbl__grid { float origin[3], per_length[3]; int place; /* among the nodes */ } sbl__grid;

/* What is left to build: triangles first .. first + count - 1 of the order, inside `box`; word `word` of the nodes will name them. */
typedef struct sbl__bvh_task { int first, count, depth; size_t word; sbl__grid grid; sbl__box box; } sbl__bvh_task;

/* Splits the task's triangles in two by place; returns how many come first, 0 where that cannot be done. `boxes` are of the triangles by number, `out` of the two halves. */
static int sbl__bvh_split(const sbl__bvh_task *t, uint32_t *order, const sbl__box *boxes, sbl__box out[2]) {
    sbl__box centroids, bins[SBL__BVH_BINS];
    int counts[SBL__BVH_BINS], axis, k, i, best_axis = -1, best_bin = 0, left = 0;
    float best = FLT_MAX, scale[3];
    sbl__box_clear(&centroids);
    for (i = t->first; i < t->first + t->count; i++) {
        const sbl__box *b = &boxes[order[i]];
        for (k = 0; k < 3; k++) {
            float c = b->low[k] + b->high[k];
            centroids.low[k] = SBL__MIN(centroids.low[k], c);
            centroids.high[k] = SBL__MAX(centroids.high[k], c);
        }
    }
    for (k = 0; k < 3; k++) {
        float size = centroids.high[k] - centroids.low[k];
        scale[k] = size > 0 ? (float)SBL__BVH_BINS * 0.99999f / size : 0;
        if (!sbl__finite(scale[k])) scale[k] = 0;
    }
    for (axis = 0; axis < 3 && t->depth < SBL__BVH_SAH_DEPTH; axis++) {
        float areas[SBL__BVH_BINS];
        sbl__box sweep;
        int n;
        if (scale[axis] <= 0) continue;
        for (k = 0; k < SBL__BVH_BINS; k++) { sbl__box_clear(&bins[k]); counts[k] = 0; }
        for (i = t->first; i < t->first + t->count; i++) {
            const sbl__box *b = &boxes[order[i]];
            int bin = (int)((b->low[axis] + b->high[axis] - centroids.low[axis]) * scale[axis]);
            sbl__box_add(&bins[bin], b);
            counts[bin]++;
        }
        sbl__box_clear(&sweep);
        n = 0;
        for (k = SBL__BVH_BINS - 1; k > 0; k--) {
            sbl__box_add(&sweep, &bins[k]);
            n += counts[k];
            areas[k] = n ? sbl__box_area(&sweep) * (float)n : 0;
        }
        sbl__box_clear(&sweep);
        n = 0;
        for (k = 0; k < SBL__BVH_BINS - 1; k++) {
            float cost;
            sbl__box_add(&sweep, &bins[k]);
            n += counts[k];
            if (n == 0 || n == t->count) continue;
            cost = sbl__box_area(&sweep) * (float)n + areas[k + 1];
            if (cost < best) { best = cost; best_axis = axis; best_bin = k; }
        }
    }
    sbl__box_clear(&out[0]);
    sbl__box_clear(&out[1]);
    if (best_axis < 0) return 0;
    for (i = t->first; i < t->first + t->count; i++) {
        const sbl__box *b = &boxes[order[i]];
        int bin = (int)((b->low[best_axis] + b->high[best_axis] - centroids.low[best_axis]) * scale[best_axis]);
        sbl__box_add(&out[bin > best_bin], b);
        if (bin <= best_bin) {
            uint32_t swap = order[t->first + left];
            order[t->first + left++] = order[i];
            order[i] = swap;
        }
    }
    return left;
}

/* A box onto a grid, a little outwards. */
static void sbl__bvh_quantise(const sbl__grid *grid, const sbl__box *b, uint32_t out[3]) {
    int k;
    for (k = 0; k < 3; k++) {
        double low = ((double)b->low[k] - grid->origin[k]) * grid->per_length[k], high = ((double)b->high[k] - grid->origin[k]) * grid->per_length[k];
        out[k] = (uint32_t)SBL__MIN(SBL__MAX(floor(low - 0.02), 0), 65535) | (uint32_t)SBL__MIN(SBL__MAX(ceil(high + 0.02), 0), 65535) << 16;
    }
}

/* The grid over a box, a step to spare at either end, in the place of the next node. */
static sbl__grid sbl__bvh_add_grid(sbl__bvh *bvh, const sbl__box *b, int around) {
    uint32_t *node = bvh->nodes + 8 * (size_t)bvh->node_count;
    float longest = SBL__MAX(b->high[0] - b->low[0], SBL__MAX(b->high[1] - b->low[1], b->high[2] - b->low[2]));
    sbl__grid grid;
    int k;
    for (k = 0; k < 3; k++) {  /* no finer than what floats resolve there */
        double size = SBL__MAX((double)b->high[k] - b->low[k], SBL__MAX(1e-4 * (double)longest, SBL__MAX(1e-6 * fabs((double)b->low[k]), 1e-30)));
        grid.per_length[k] = (float)(65533 / size);
        grid.origin[k] = (float)(b->low[k] - size / 65533);
    }
    grid.place = bvh->node_count++;
    memcpy(node, grid.origin, 12);
    node[3] = (uint32_t)grid.place + 1;  /* its root follows */
    memcpy(node + 4, grid.per_length, 12);
    node[7] = (uint32_t)around;
    return grid;
}

/* A triangle's nine coordinates and its number. */
typedef struct sbl__bvh_corners { uint32_t words[10]; } sbl__bvh_corners;

static int sbl__bvh_corner_order(const void *first, const void *second) {
    const uint32_t *a = ((const sbl__bvh_corners *)first)->words, *b = ((const sbl__bvh_corners *)second)->words;
    int k = 0;
    while (k < 9 && a[k] == b[k]) k++;
    return a[k] < b[k] ? -1 : a[k] > b[k];
}

static int sbl__is_cutout(const sbl__scene *s, uint32_t triangle) {
    return s->objects[(size_t)SBL__OBJECT_WORDS * s->vertices[s->indices[3 * (size_t)triangle]].object + 3] != 0;
}

/* Of triangles that lie exactly on each other only the first can be seen: a thousand copies must not cost a thousand tests. Shortens the task. */
static sbl_result sbl__bvh_drop_copies(sbl__base *base, const sbl__scene *s, uint32_t *order, sbl__bvh_task *t) {
    sbl__bvh_corners *corners = (sbl__bvh_corners *)sbl__alloc(base, (size_t)t->count, sizeof *corners);
    int i, k, kept = 0, last = 0;
    if (!corners) return SBL_ERROR_OUT_OF_MEMORY;
    for (i = 0; i < t->count; i++) {
        uint32_t number = order[t->first + i];
        for (k = 0; k < 3; k++) memcpy(corners[i].words + 3 * k, s->vertices[s->indices[3 * (size_t)number + (size_t)k]].position, 12);
        corners[i].words[9] = number;
    }
    qsort(corners, (size_t)t->count, sizeof *corners, sbl__bvh_corner_order);
    for (i = 0; i < t->count; i++) {
        uint32_t number = corners[i].words[9];
        if (i && !memcmp(corners[i].words, corners[last].words, 36) && !sbl__is_cutout(s, corners[last].words[9])) continue;
        last = i;
        order[t->first + kept++] = number;
    }
    for (i = kept; i < t->count; i++) order[t->first + i] = SBL__BVH_DROPPED;
    t->count = kept;
    sbl__free(base, corners);
    return SBL_SUCCESS;
}

static void sbl__bvh_free(sbl__base *base, sbl__bvh *bvh) {
    sbl__free(base, bvh->nodes);
    sbl__free(base, bvh->order);
    memset(bvh, 0, sizeof *bvh);
}

/* Of a node: what rays through it meet on average, times its area. */
typedef struct sbl__bvh_work { double sum; float area; int parent; } sbl__bvh_work;

static sbl_result sbl__bvh_build(sbl__base *base, sbl__bvh *bvh, const sbl__scene *s) {
    double start = sbl__now();
    size_t room = (size_t)SBL__MAX(1, s->triangle_count);
    sbl__box *boxes;
    sbl__bvh_work *work;
    sbl__bvh_task stack[2 * SBL__BVH_STACK], *task = stack;
    sbl_result result = SBL_SUCCESS;
    int top = 0, i, k;
    memset(bvh, 0, sizeof *bvh);
    if (!s->triangle_count) return SBL_SUCCESS;
    bvh->nodes = (uint32_t *)sbl__alloc(base, room + room / SBL__BVH_GRID_LEAST + 2, 32);
    bvh->order = (uint32_t *)sbl__alloc(base, room, 4);
    boxes = (sbl__box *)sbl__alloc(base, room, sizeof *boxes);
    work = (sbl__bvh_work *)sbl__alloc(base, room + room / SBL__BVH_GRID_LEAST + 2, sizeof *work);
    if (!bvh->nodes || !bvh->order || !boxes || !work) {
        sbl__bvh_free(base, bvh);
        sbl__free(base, boxes);
        sbl__free(base, work);
        return SBL_ERROR_OUT_OF_MEMORY;
    }
    sbl__box_clear(&task->box);
    for (i = 0; i < s->triangle_count; i++) {
        int corner;
        const uint32_t *object = s->objects + (size_t)SBL__OBJECT_WORDS * s->vertices[s->indices[3 * (size_t)i]].object;
        if (object[7] & SBL_MATERIAL_HIDDEN_FROM_SENSORS) continue;
        bvh->order[bvh->triangle_count++] = (uint32_t)i;
        sbl__box_clear(&boxes[i]);
        for (corner = 0; corner < 3; corner++) {
            const float *p = s->vertices[s->indices[3 * (size_t)i + (size_t)corner]].position;
            for (k = 0; k < 3; k++) {
                boxes[i].low[k] = SBL__MIN(boxes[i].low[k], p[k]);
                boxes[i].high[k] = SBL__MAX(boxes[i].high[k], p[k]);
            }
        }
        sbl__box_add(&task->box, &boxes[i]);
    }
    if (bvh->triangle_count) {  /* else sensors may see nothing at all */
        task->first = task->depth = 0;
        task->count = bvh->triangle_count;
        task->grid = sbl__bvh_add_grid(bvh, &task->box, 0);
        task->word = 3;
        memcpy(bvh->grid_origin, task->grid.origin, 12);
        memcpy(bvh->grid_per_length, task->grid.per_length, 12);
        top = 1;
    }
    while (top && result == SBL_SUCCESS) {
        sbl__bvh_task t = stack[--top];
        sbl__box halves[2];
        uint32_t *node;
        int left, side, fine = 1;
        for (k = 0; k < 3; k++) fine &= (t.box.high[k] - t.box.low[k]) * t.grid.per_length[k] < SBL__BVH_GRID_STEPS;
        if (fine && t.count >= SBL__BVH_GRID_LEAST && t.depth < SBL__BVH_SAH_DEPTH) {
            t.depth++;
            bvh->nodes[t.word] = 0xc0000000u | (uint32_t)bvh->node_count;
            t.grid = sbl__bvh_add_grid(bvh, &t.box, t.grid.place);
        } else bvh->nodes[t.word] = (uint32_t)bvh->node_count;
        left = sbl__bvh_split(&t, bvh->order, boxes, halves);
        if (!left) {  /* all at one place, or too deep: halves by number; one triangle leaves a child that nothing enters */
            result = sbl__bvh_drop_copies(base, s, bvh->order, &t);
            left = t.count / 2;
            for (i = 0; i < t.count; i++) sbl__box_add(&halves[i >= left], &boxes[bvh->order[t.first + i]]);
        }
        bvh->depth = SBL__MAX(bvh->depth, t.depth + 1);
        work[bvh->node_count].area = sbl__box_area(&t.box);
        work[bvh->node_count].parent = (int)(t.word / 8);
        node = bvh->nodes + 8 * (size_t)bvh->node_count;
        for (side = 0; side < 2; side++) {
            int first = side ? t.first + left : t.first, count = side ? t.count - left : left;
            sbl__bvh_quantise(&t.grid, &halves[side], node + 4 * side);
            work[bvh->node_count].sum += (double)sbl__box_area(&halves[side]) * (count <= SBL__BVH_LEAF ? 1 + count : 1);
            if (count <= SBL__BVH_LEAF) node[4 * side + 3] = 0x80000000u | (uint32_t)(SBL__MAX(1, count) - 1) << 28 | (uint32_t)first;
            else {
                task = &stack[top++];
                task->first = first;
                task->count = count;
                task->depth = t.depth + 1;
                task->word = 8 * (size_t)bvh->node_count + 4 * (size_t)side + 3;
                task->grid = t.grid;
                task->box = halves[side];
            }
        }
        bvh->node_count++;
    }
    sbl__free(base, boxes);
    for (i = bvh->node_count - 1; i > 0 && result == SBL_SUCCESS; i--) {  /* children come after their parents */
        work[work[i].parent].sum += work[i].sum;
        if (work[i].area > 0) bvh->cost = SBL__MAX(bvh->cost, work[i].sum / work[i].area);
    }
    sbl__free(base, work);
    if (result != SBL_SUCCESS) sbl__bvh_free(base, bvh);
    bvh->seconds = sbl__now() - start;
    return result;
}

/* ======================================================================================================== >>lamps
   What sensors aim rays at: emitting triangles, lights, and what of the environment is too bright to be left to chance. Two trees, of near lamps and of
   directions, hold clusters of neighbours, so that the work of a sensor grows with their logarithm (lamps.glsl). One array of 4 x 32-bit texels:

       nodes   in preorder, 4 texels: middle and radius of a ball around all lamps;  xx, yy, zz of the sum of power * normal * normal^T, power;
               xy, xz, yz of it, the node after this one's subtree (bit 31: directions);  sum of power * normal of one-sided lamps, first leaf
       leaves  in the nodes' order: kind << 30 | number, 0, 0, 0
       lights  3 texels: position or direction to it, radius or sine squared of half its angle;  intensity, spot's scale;  spot's axis, spot's offset

   Power is light per solid angle over pi where the lamp shows its face: R at distance d is about power * cosine / d^2, for directions power * cosine. */

#define SBL__MAX_LAMPS 256     /* entries that lamps.glsl weighs against each other: so many lamps are taken one by one */

enum { SBL__LAMP_TRIANGLE, SBL__LAMP_NEAR_LIGHT, SBL__LAMP_FAR_LIGHT, SBL__LAMP_SKY_TEXEL };

typedef struct sbl__lamp {
    uint64_t curve;            /* place along a Morton curve; near before far */
    uint32_t code;
    float low[3], high[3];     /* bounds */
    float normal[3];           /* 0: shines to all sides; of directions, the direction */
    float power;
    int one_sided, far;
} sbl__lamp;

typedef struct sbl__lamps {
    sbl__lamp *list;
    int count, room;
    uint32_t *words;           /* as the GPU gets them */
    int nodes;
} sbl__lamps;

static int sbl__lamps_add(sbl__base *base, sbl__lamps *l, const sbl__lamp *lamp) {
    if (!(lamp->power > 0)) return 1;
    if (l->count == l->room) {
        int room = l->room * 2 + 256;
        sbl__lamp *list = (sbl__lamp *)sbl__alloc(base, (size_t)room, sizeof *list);
        if (!list) return 0;
        if (l->count) memcpy(list, l->list, (size_t)l->count * sizeof *list);
        sbl__free(base, l->list);
        l->list = list;
        l->room = room;
    }
    l->list[l->count++] = *lamp;
    return 1;
}

/* A lamp without sides, in bounds of so much around its middle. */
static void sbl__lamp_make(sbl__lamp *lamp, int kind, uint32_t number, const double middle[3], double around, double power) {
    int k;
    memset(lamp, 0, sizeof *lamp);
    lamp->code = (uint32_t)kind << 30 | number;
    lamp->power = (float)SBL__MIN(power / SBL__PI, 1e37);
    for (k = 0; k < 3; k++) {
        lamp->low[k] = (float)(middle[k] - around);
        lamp->high[k] = (float)(middle[k] + around);
    }
}

static double sbl__sum3(const float v[3]) { return (double)v[0] + v[1] + v[2]; }

/* Triangle `number` of the scene, `place` in the hierarchy's order. */
static int sbl__lamps_add_triangle(sbl__base *base, sbl__lamps *l, const sbl__scene *s, uint32_t number, uint32_t place) {
    const float *p[3];
    const uint32_t *object = s->objects + (size_t)SBL__OBJECT_WORDS * s->vertices[s->indices[3 * (size_t)number]].object;
    double a[3], b[3], normal[3], zero[3] = { 0, 0, 0 }, area;
    float emission[3];
    sbl__lamp lamp;
    int i, k;
    memcpy(emission, object + 4, sizeof emission);
    if (!(emission[0] + emission[1] + emission[2] > 0)) return 1;
    for (i = 0; i < 3; i++) p[i] = s->vertices[s->indices[3 * (size_t)number + (size_t)i]].position;
    for (k = 0; k < 3; k++) { a[k] = (double)p[1][k] - p[0][k]; b[k] = (double)p[2][k] - p[0][k]; }
    normal[0] = a[1] * b[2] - a[2] * b[1]; normal[1] = a[2] * b[0] - a[0] * b[2]; normal[2] = a[0] * b[1] - a[1] * b[0];
    area = 0.5 * sqrt(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]);
    sbl__lamp_make(&lamp, SBL__LAMP_TRIANGLE, place, zero, 0, SBL__MAX(area * sbl__sum3(emission), 1e-30));
    for (k = 0; k < 3; k++) {
        lamp.low[k] = SBL__MIN(p[0][k], SBL__MIN(p[1][k], p[2][k]));
        lamp.high[k] = SBL__MAX(p[0][k], SBL__MAX(p[1][k], p[2][k]));
        if (area > 0) lamp.normal[k] = (float)(0.5 * normal[k] / area);
    }
    lamp.one_sided = (object[7] & SBL_MATERIAL_ONE_SIDED_EMISSION) != 0;
    return sbl__lamps_add(base, l, &lamp);
}

static int sbl__lamps_add_light(sbl__base *base, sbl__lamps *l, const sbl_light *light, int number, float record[12]) {
    const int far = light->kind == SBL_LIGHT_DIRECTIONAL;
    double axis[3], place[3], scale = 0, offset = 1, half = 0.5 * light->angle * SBL__PI / 180;
    sbl__lamp lamp;
    int k;
    for (k = 0; k < 3; k++) axis[k] = light->direction[k];
    sbl__normalize(axis);
    if (light->kind == SBL_LIGHT_SPOT) {
        double outer = cos(0.5 * SBL__CONE(light) * SBL__PI / 180);
        scale = 1 / SBL__MAX(0.001, cos(0.5 * light->inner_cone * SBL__PI / 180) - outer);
        offset = -outer * scale;
    }
    for (k = 0; k < 3; k++) {
        place[k] = far ? -axis[k] : light->position[k];
        record[k] = (float)place[k];
        record[4 + k] = light->intensity[k];
        record[8 + k] = (float)(light->kind == SBL_LIGHT_SPOT ? axis[k] : 0);
    }
    record[3] = (float)(far ? sin(half) * sin(half) : light->radius);
    record[7] = (float)scale;
    record[11] = (float)offset;
    sbl__lamp_make(&lamp, far ? SBL__LAMP_FAR_LIGHT : SBL__LAMP_NEAR_LIGHT, (uint32_t)number, place, far ? 2 * sin(0.5 * half) : light->radius, sbl__sum3(light->intensity));
    lamp.far = far;
    for (k = 0; far && k < 3; k++) lamp.normal[k] = (float)place[k];
    return sbl__lamps_add(base, l, &lamp);
}

static int sbl__lamps_add_sky(sbl__base *base, sbl__lamps *l, const sbl__scene *s) {
    int x, y, k;
    for (y = 0; y < s->sky_height && s->sky_pixels; y++)
        for (x = 0; x < s->sky_width; x++) {
            const float *c = s->sky_pixels + 3 * ((size_t)y * (size_t)s->sky_width + (size_t)x);
            const double step = SBL__PI / s->sky_height, solid_angle = 2 * SBL__PI / s->sky_width * 2 * sin(step * (y + 0.5)) * sin(0.5 * step);
            double direction[3];
            sbl__lamp lamp;
            if (!(sbl__max3(c) > s->sky_limit)) continue;
            sbl__sky_direction(s, x, y, direction);
            sbl__lamp_make(&lamp, SBL__LAMP_SKY_TEXEL, (uint32_t)y << 15 | (uint32_t)x, direction, SBL__MIN(step + 2 * SBL__PI / s->sky_width, 1.0),
                           sbl__sum3(c) * (1 - s->sky_limit / sbl__max3(c)) * solid_angle);
            lamp.far = 1;
            for (k = 0; k < 3; k++) lamp.normal[k] = (float)direction[k];
            if (!sbl__lamps_add(base, l, &lamp)) return 0;
        }
    return 1;
}

static int sbl__lamp_order(const void *first, const void *second) {
    const sbl__lamp *a = (const sbl__lamp *)first, *b = (const sbl__lamp *)second;
    if (a->curve != b->curve) return a->curve < b->curve ? -1 : 1;
    return a->code < b->code ? -1 : a->code > b->code;
}

/* Along a Morton curve through the bounds of all near lamps, 20 bits an axis; then the directions. */
static void sbl__lamps_sort(sbl__lamps *l) {
    double low[3] = { DBL_MAX, DBL_MAX, DBL_MAX }, side = 0;
    int i, k, bit;
    for (i = 0; i < l->count; i++)
        for (k = 0; k < 3 && !l->list[i].far; k++) low[k] = SBL__MIN(low[k], 0.5 * ((double)l->list[i].low[k] + l->list[i].high[k]));
    for (i = 0; i < l->count; i++)
        for (k = 0; k < 3 && !l->list[i].far; k++) side = SBL__MAX(side, 0.5 * ((double)l->list[i].low[k] + l->list[i].high[k]) - low[k]);
    for (i = 0; i < l->count; i++) {
        sbl__lamp *lamp = &l->list[i];
        lamp->curve = (uint64_t)lamp->far << 63;
        for (k = 0; k < 3; k++) {
            double middle = 0.5 * ((double)lamp->low[k] + lamp->high[k]), share = lamp->far ? 0.25 * (middle + 2) : side > 0 ? (middle - low[k]) / side : 0;
            uint64_t place = (uint64_t)(SBL__MIN(SBL__MAX(share, 0.0), 1.0) * 1048575.0);
            for (bit = 0; bit < 20; bit++) lamp->curve |= (place >> bit & 1u) << (3 * bit + k);
        }
    }
    if (l->count) qsort(l->list, (size_t)l->count, sizeof *l->list, sbl__lamp_order);
}

typedef struct sbl__cluster { double power, all_sides, square[6], front[3]; float low[3], high[3]; } sbl__cluster;

/* The subtree of lamps first .. first + count - 1, and what is known of them together. Depth: the curve's 61 bits, and the logarithm of count. */
static void sbl__lamps_node(sbl__lamps *l, int first, int count, sbl__cluster *c) {
    const int node = l->nodes++, far = l->list[first].far;
    uint32_t *words = l->words + 16 * (size_t)node, after;
    double radius = 0;
    float out[16];
    int k;
    memset(c, 0, sizeof *c);
    if (count == 1) {
        static const int pairs[6][2] = { { 0, 0 }, { 1, 1 }, { 2, 2 }, { 0, 1 }, { 1, 2 }, { 2, 0 } };  /* the last three as lamps.glsl multiplies them */
        const sbl__lamp *lamp = &l->list[first];
        const int sides = !sbl__all_zero(lamp->normal, 3);
        const double shown = lamp->one_sided || lamp->far ? 0.5 * lamp->power : lamp->power;  /* max(x, 0) = (|x| + x) / 2 */
        c->power = lamp->power;
        c->all_sides = shown;
        for (k = 0; k < 6; k++) c->square[k] = sides ? shown * lamp->normal[pairs[k][0]] * lamp->normal[pairs[k][1]] : k < 3 ? shown : 0;
        for (k = 0; k < 3; k++) {
            c->front[k] = lamp->one_sided || lamp->far ? shown * lamp->normal[k] : 0;
            c->low[k] = lamp->low[k];
            c->high[k] = lamp->high[k];
        }
    } else {
        int split = first + count / 2;
        uint64_t differs = l->list[first].curve ^ l->list[first + count - 1].curve;
        sbl__cluster half;
        if (differs) {  /* where the highest bit that differs turns */
            int low = first, high = first + count - 1;
            while (differs & (differs - 1)) differs &= differs - 1;
            while (high - low > 1) {
                int middle = low + (high - low) / 2;
                if (l->list[middle].curve & differs) high = middle;
                else low = middle;
            }
            split = high;
        }
        sbl__lamps_node(l, first, split - first, c);
        sbl__lamps_node(l, split, first + count - split, &half);
        c->power += half.power;
        c->all_sides += half.all_sides;
        for (k = 0; k < 6; k++) c->square[k] += half.square[k];
        for (k = 0; k < 3; k++) {
            c->front[k] += half.front[k];
            c->low[k] = SBL__MIN(c->low[k], half.low[k]);
            c->high[k] = SBL__MAX(c->high[k], half.high[k]);
        }
    }
    for (k = 0; k < 3; k++) {
        double side = 0.5 * ((double)c->high[k] - c->low[k]);
        out[k] = (float)(0.5 * ((double)c->high[k] + c->low[k]));
        radius += side * side;
        out[4 + k] = (float)(SBL__MIN(c->all_sides, 1e18) * SBL__MIN(c->square[k], 1e18));  /* sum |x| <= sqrt(sum 1 * sum x^2) */
        out[8 + k] = (float)(SBL__MIN(c->all_sides, 1e18) * SBL__MAX(SBL__MIN(c->square[3 + k], 1e18), -1e18));
        out[12 + k] = (float)c->front[k];
    }
    out[3] = (float)(1.000001 * sqrt(radius));
    out[7] = (float)c->power;
    out[11] = out[15] = 0;
    memcpy(words, out, sizeof out);
    after = (uint32_t)l->nodes | (far ? 0x80000000u : 0u);
    words[11] = after;
    words[15] = (uint32_t)first;
}

/* Collects the scene's lamps; lights of the scene are numbered as in s->lights. */
static sbl_result sbl__lamps_make(const sbl__gl *gl, sbl__scene *s) {
    sbl__lamps l;
    sbl__cluster all;
    uint32_t *leaf, place;
    size_t words;
    int i, near = 0, ok;
    float (*records)[12] = (float (*)[12])sbl__alloc(gl->base, (size_t)s->light_count, sizeof *records);
    sbl_result result = SBL_ERROR_OUT_OF_MEMORY;
    memset(&l, 0, sizeof l);
    ok = records != NULL;
    for (place = 0; place < (uint32_t)s->bvh.triangle_count && ok; place++)
        if (s->bvh.order[place] != SBL__BVH_DROPPED) ok = sbl__lamps_add_triangle(gl->base, &l, s, s->bvh.order[place], place);
    for (i = 0; i < s->light_count && ok; i++) ok = sbl__lamps_add_light(gl->base, &l, &s->lights[i], i, records[i]);
    if (ok) ok = sbl__lamps_add_sky(gl->base, &l, s);
    words = 16 * 2 * (size_t)l.count + 4 * (size_t)l.count + 12 * (size_t)s->light_count;
    if (ok) l.words = (uint32_t *)sbl__alloc(gl->base, words, 4);
    if (l.words) {
        sbl__lamps_sort(&l);
        for (near = 0; near < l.count && !l.list[near].far; near++) {}
        if (near) sbl__lamps_node(&l, 0, near, &all);
        if (l.count > near) sbl__lamps_node(&l, near, l.count - near, &all);
        leaf = l.words + 16 * (size_t)l.nodes;
        for (i = 0; i < l.count; i++, leaf += 4) leaf[0] = l.list[i].code;
        if (s->light_count) memcpy(leaf, records, (size_t)s->light_count * sizeof *records);
        s->lamp_nodes = l.nodes;
        s->lamp_leaves = l.count;
        result = sbl__buffer_make(gl, &s->lamp_buffer, 4 * (16 * (size_t)l.nodes + 4 * (size_t)l.count + 12 * (size_t)s->light_count), l.words, SBL__GL_STATIC_DRAW, "storing lamps");
        if (result == SBL_SUCCESS) result = sbl__texels_make(gl, &s->lamp_texels, SBL__GL_RGBA32UI, &s->lamp_buffer, s->wide, "making the lamps' texture");
        if (s->wide) sbl__buffer_delete(gl, &s->lamp_buffer);
    }
    sbl__free(gl->base, records);
    sbl__free(gl->base, l.list);
    sbl__free(gl->base, l.words);
    return result;
}

/* Builds hierarchy and lamps where they are not there yet, and brings them to the GPU. */
static sbl_result sbl__bvh_ready(const sbl__gl *gl, sbl__scene *s) {
    uint32_t *words;
    size_t i;
    int corner;
    sbl_result result;
    if (s->bvh_ready) return SBL_SUCCESS;
    sbl__bvh_free(gl->base, &s->bvh);
    result = sbl__bvh_build(gl->base, &s->bvh, s);
    if (result != SBL_SUCCESS) return result;
    words = (uint32_t *)sbl__alloc(gl->base, (size_t)s->bvh.triangle_count, 48);
    if (!words) return SBL_ERROR_OUT_OF_MEMORY;
    for (i = 0; i < (size_t)s->bvh.triangle_count; i++) {
        const uint32_t number = s->bvh.order[i];
        for (corner = 0; corner < 3 && number != SBL__BVH_DROPPED; corner++) {
            uint32_t *to = words + 12 * i + 4 * (size_t)corner;
            const sbl__vertex *v = &s->vertices[s->indices[3 * (size_t)number + (size_t)corner]];
            memcpy(to, v->position, 12);
            to[3] = corner == 0 ? v->object : corner == 1 ? number : (uint32_t)sbl__is_cutout(s, number);
        }
    }
    gl->BindVertexArray(0);
    result = sbl__buffer_make(gl, &s->triangle_buffer, 48 * (size_t)s->bvh.triangle_count, words, SBL__GL_STATIC_DRAW, "storing triangles");
    sbl__free(gl->base, words);
    if (result == SBL_SUCCESS) result = sbl__buffer_make(gl, &s->node_buffer, 32 * (size_t)s->bvh.node_count, s->bvh.nodes, SBL__GL_STATIC_DRAW, "storing the hierarchy");
    if (result == SBL_SUCCESS) result = sbl__texels_make(gl, &s->node_texels, SBL__GL_RGBA32UI, &s->node_buffer, s->wide, "making the hierarchy's texture");
    if (result == SBL_SUCCESS) result = sbl__texels_make(gl, &s->triangle_texels, SBL__GL_RGBA32UI, &s->triangle_buffer, s->wide, "making the triangles' texture");
    if (result == SBL_SUCCESS) result = sbl__lamps_make(gl, s);
    if (s->wide) {  /* copied */
        sbl__buffer_delete(gl, &s->node_buffer);
        sbl__buffer_delete(gl, &s->triangle_buffer);
    }
    sbl__free(gl->base, s->bvh.nodes);   /* the GPU has them; the build is repeated when a mesh moves */
    sbl__free(gl->base, s->bvh.order);
    s->bvh.nodes = s->bvh.order = NULL;
    s->bvh_ready = result == SBL_SUCCESS;
    return result;
}

/* ======================================================================================================== >>surface
   Where light is wanted: the camera's G-buffer (section III-F), once per picture at pixel centres and once per anti-aliasing sample. */

typedef struct sbl__gbuffer {
    sbl__texture position, normal, geometric_normal, albedo, emission, id, depth;
    unsigned framebuffer;
} sbl__gbuffer;

/* What the rasteriser and the rays of the G-buffer need; rows are of world to view, the world taken relative to the eye. */
typedef struct sbl__camera {
    double eye[3], right[3], up[3], back[3];
    float world_to_view[16], view_to_clip[16];
    int orthographic;
    double nearest, farthest;  /* orthographic: distances that depth 1 and 0 stand for */
    float depth_scale;         /* perspective: depth is depth_scale / w */
    float facet_limit;         /* see sbl_picture_desc */
} sbl__camera;

static sbl_result sbl__gbuffer_make(const sbl__gl *gl, sbl__gbuffer *g, int width, int height) {
    const char *what = "making the G-buffer";
    const sbl__texture *colors[6];
    sbl_result result = sbl__texture_make(gl, &g->position, width, height, SBL__GL_RGBA32F, NULL, what);
    if (result == SBL_SUCCESS) result = sbl__texture_make(gl, &g->normal, width, height, SBL__GL_RGBA32F, NULL, what);
    if (result == SBL_SUCCESS) result = sbl__texture_make(gl, &g->geometric_normal, width, height, SBL__GL_RGBA32F, NULL, what);
    if (result == SBL_SUCCESS) result = sbl__texture_make(gl, &g->albedo, width, height, SBL__GL_RGBA16F, NULL, what);
    if (result == SBL_SUCCESS) result = sbl__texture_make(gl, &g->emission, width, height, SBL__GL_RGBA32F, NULL, what);
    if (result == SBL_SUCCESS) result = sbl__texture_make(gl, &g->id, width, height, SBL__GL_R32UI, NULL, what);
    if (result == SBL_SUCCESS) result = sbl__texture_make(gl, &g->depth, width, height, SBL__GL_DEPTH_COMPONENT32F, NULL, what);
    if (result != SBL_SUCCESS) return result;
    colors[0] = &g->position; colors[1] = &g->normal; colors[2] = &g->geometric_normal;
    colors[3] = &g->albedo; colors[4] = &g->emission; colors[5] = &g->id;
    return sbl__framebuffer_make(gl, &g->framebuffer, colors, 6, &g->depth, what);
}

static void sbl__gbuffer_free(const sbl__gl *gl, sbl__gbuffer *g) {
    sbl__name_delete(gl->DeleteFramebuffers, &g->framebuffer);
    sbl__texture_delete(gl, &g->position);
    sbl__texture_delete(gl, &g->normal);
    sbl__texture_delete(gl, &g->geometric_normal);
    sbl__texture_delete(gl, &g->albedo);
    sbl__texture_delete(gl, &g->emission);
    sbl__texture_delete(gl, &g->id);
    sbl__texture_delete(gl, &g->depth);
}

/* desc's matrices are checked already. */
static void sbl__camera_make(sbl__camera *c, const sbl_picture_desc *desc, const sbl__scene *scene) {
    const float *m = desc->world_to_view;
    int i, k;
    memcpy(c->world_to_view, m, sizeof c->world_to_view);
    memcpy(c->view_to_clip, desc->view_to_clip, sizeof c->view_to_clip);
    for (k = 0; k < 3; k++) { c->right[k] = m[4 * k]; c->up[k] = m[4 * k + 1]; c->back[k] = m[4 * k + 2]; }
    for (k = 0; k < 3; k++) c->eye[k] = -(c->right[k] * m[12] + c->up[k] * m[13] + c->back[k] * m[14]);
    c->orthographic = desc->view_to_clip[11] == 0.0f;
    c->depth_scale = 1e-6f * scene->extent;
    c->nearest = DBL_MAX;
    c->farthest = -DBL_MAX;
    for (i = 0; i < 8; i++) {
        double distance = 0;
        for (k = 0; k < 3; k++) distance -= c->back[k] * ((double)scene->bounds[(i >> k) & 1][k] - c->eye[k]);
        c->nearest = SBL__MIN(c->nearest, distance);
        c->farthest = SBL__MAX(c->farthest, distance);
    }
    c->nearest -= 1e-3 * scene->extent;
    c->farthest += 1e-3 * scene->extent;
}

/* view_to_clip as the G-buffer is drawn: shifted by the sample's offset (pixels), top row first, reversed depth. */
static void sbl__camera_clip(const sbl__camera *c, const float offset[2], int width, int height, float out[16]) {
    const float *m = c->view_to_clip;
    int k;
    memset(out, 0, 16 * sizeof(float));
    for (k = 0; k < 4; k++) {
        float w = m[4 * k + 3];
        out[4 * k] = m[4 * k] - 2 * offset[0] / (float)width * w;
        out[4 * k + 1] = -m[4 * k + 1] - 2 * offset[1] / (float)height * w;
        out[4 * k + 3] = w;
    }
    if (c->orthographic) {  /* depth falls from 1 at the nearest to 0 at the farthest point of the scene */
        out[10] = (float)(1 / (c->farthest - c->nearest));
        out[14] = (float)(c->farthest / (c->farthest - c->nearest));
    } else out[14] = c->depth_scale;
}

/* A pixel's ray: origin, then direction, each constant, per pixel of x, per pixel of y; offset from the pixel's centre. */
static void sbl__camera_rays(const sbl__camera *c, const float offset[2], int width, int height, double ray[6][3]) {
    const float *m = c->view_to_clip;
    double a = c->orthographic ? 1 : -(double)m[11], step_x = 2.0 / width, step_y = -2.0 / height;
    double x0 = -1 + offset[0] * step_x, y0 = 1 + offset[1] * step_y;
    int k;
    /* x of the view at unit distance (perspective) or everywhere (orthographic) is linear in the pixel: x = (a ndc + m8) / m0 or (ndc - m12) / m0 */
    for (k = 0; k < 3; k++) {
        double across = c->orthographic ? (x0 - m[12]) / m[0] : (a * x0 + m[8]) / m[0];
        double down = c->orthographic ? (y0 - m[13]) / m[5] : (a * y0 + m[9]) / m[5];
        double dx = a * step_x / m[0], dy = a * step_y / m[5];
        int moving = c->orthographic ? 0 : 3, still = 3 - moving;
        ray[moving][k] = across * c->right[k] + down * c->up[k] + (c->orthographic ? c->eye[k] : -c->back[k]);
        ray[moving + 1][k] = dx * c->right[k];
        ray[moving + 2][k] = dy * c->up[k];
        ray[still][k] = c->orthographic ? -c->back[k] : c->eye[k];
        ray[still + 1][k] = ray[still + 2][k] = 0;
    }
}

static void sbl__surface_draw(const sbl__gl *gl, unsigned program, const sbl__scene *scene, const sbl__camera *c, sbl__gbuffer *g, const float offset[2], float epsilon) {
    static const float zero[4] = { 0, 0, 0, 0 };
    static const unsigned none[4] = { 0, 0, 0, 0 };
    int width = g->position.width, height = g->position.height, i, k;
    float clip[16];
    double ray[6][3];

    gl->BindFramebuffer(SBL__GL_DRAW_FRAMEBUFFER, g->framebuffer);
    gl->Viewport(0, 0, width, height);
    gl->Enable(SBL__GL_DEPTH_TEST);
    for (i = 0; i < 5; i++) gl->ClearBufferfv(SBL__GL_COLOR, i, zero);
    gl->ClearBufferuiv(SBL__GL_COLOR, 5, none);
    gl->ClearBufferfv(SBL__GL_DEPTH, 0, zero);
    sbl__camera_clip(c, offset, width, height, clip);
    sbl__camera_rays(c, offset, width, height, ray);
    if (scene->triangle_count) {
        static const char *const names[6] = { "origin_0", "origin_x", "origin_y", "direction_0", "direction_x", "direction_y" };
        static const char *const rows[4] = { "clip_x", "clip_y", "clip_z", "clip_w" };
        gl->UseProgram(program);
        sbl__scene_bind(gl, scene, program);
        for (i = 0; i < 6; i++) gl->Uniform3f(sbl__uniform(gl, program, names[i]), (float)ray[i][0], (float)ray[i][1], (float)ray[i][2]);
        for (i = 0; i < 4; i++) {
            double row[3];
            for (k = 0; k < 3; k++) row[k] = clip[i] * c->right[k] + clip[4 + i] * c->up[k] + clip[8 + i] * c->back[k];
            gl->Uniform4f(sbl__uniform(gl, program, rows[i]), (float)row[0], (float)row[1], (float)row[2], clip[12 + i]);
        }
        gl->Uniform3f(sbl__uniform(gl, program, "eye"), (float)c->eye[0], (float)c->eye[1], (float)c->eye[2]);
        sbl__uniform_f(gl, program, "facet_limit", c->facet_limit);
        gl->Uniform2f(sbl__uniform(gl, program, "depth_from_w"), c->orthographic ? 0 : c->depth_scale, 0);
        gl->BindVertexArray(scene->vertex_array);
        gl->DrawElements(SBL__GL_TRIANGLES, 3 * scene->triangle_count, SBL__GL_UNSIGNED_INT, NULL);
    }
    if (scene->draw) {
        sbl_draw_view view;
        memset(&view, 0, sizeof view);
        view.kind = SBL_VIEW_CAMERA;
        view.viewport[2] = width;
        view.viewport[3] = height;
        memcpy(view.world_to_view, c->world_to_view, sizeof view.world_to_view);
        memcpy(view.view_to_clip, clip, sizeof view.view_to_clip);
        sbl__multiply(view.world_to_clip, clip, c->world_to_view);
        for (k = 0; k < 3; k++) view.eye[k] = (float)c->eye[k];
        view.radiance_scale = 1;
        view.depth_scale = c->depth_scale;
        view.write_depth = !(gl->capabilities.used & SBL_CAPABILITY_CLIP_CONTROL);
        view.epsilon = epsilon;
        gl->Scissor(0, 0, width, height);
        gl->Enable(SBL__GL_SCISSOR_TEST);
        scene->draw(&view, scene->draw_user);
        sbl__guard_force(gl);
    }
}

/* ======================================================================================================== >>sensors
   Where a sensor stands and looks, how its views lie on its sheet, and what each texel weighs. */

#define SBL__MAX_LOOKS 4         /* see sbl__looks */

typedef struct sbl__site {
    float position[3];          /* already moved off the surface */
    float normal[3];            /* unit */
    float offset;               /* how far it is off the surface */
    float turn;                 /* rotation about the normal, radians: rasterised sensors */
    uint32_t seed;              /* scrambles the directions: traced sensors */
    uint32_t first_ray;         /* in the sequence of directions */
} sbl__site;

typedef struct sbl__layout {
    int hemicube, size, view_count;
    double tangent;             /* of half the view's width: 1 for a hemicube */
    int rects[5][4];            /* x, y, width, height in the sheet */
    int sheet_width, sheet_height;            /* without padding */
    int block, blocks[2];       /* the reduction's first step adds block x block texels; the sheet is padded to whole blocks */
} sbl__layout;

/* As the vertex shader takes it, see sensor_vertex.glsl. */
typedef struct sbl__view { float eye[3], right[4], up[4], forward[4], offset[2]; } sbl__view;

static void sbl__layout_make(sbl__layout *l, int hemicube, int size, float fov) {
    int half = (size + 1) / 2, i;
    memset(l, 0, sizeof *l);
    l->hemicube = hemicube;
    l->size = size;
    l->view_count = hemicube ? 5 : 1;
    l->tangent = hemicube ? 1 : tan(0.5 * (double)fov * SBL__PI / 180);
    l->sheet_width = hemicube ? 2 * size : size;
    l->sheet_height = hemicube ? SBL__MAX(size, 2 * half) + half : size;
    l->rects[0][2] = l->rects[0][3] = size;
    for (i = 1; i < l->view_count; i++) {
        l->rects[i][0] = i == 3 ? 0 : size;
        l->rects[i][1] = i == 1 ? 0 : i == 2 ? half : 2 * half;
        l->rects[i][2] = size;
        l->rects[i][3] = half;
    }
    l->block = size < 128 ? 8 : size < 256 ? 16 : 32;
    l->blocks[0] = (l->sheet_width + l->block - 1) / l->block;
    l->blocks[1] = (l->sheet_height + l->block - 1) / l->block;
}

/* Tangents to a normal: Duff et al. 2017, "Building an Orthonormal Basis, Revisited". right x up = -normal, as in a view that looks along it. */
static void sbl__frame(const float n[3], double turn, double right[3], double up[3]) {
    double s = n[2] < 0.0f ? -1 : 1, a = -1 / (s + n[2]), b = (double)n[0] * n[1] * a, c = cos(turn), d = sin(turn);
    double t[3], u[3];
    int k;
    t[0] = 1 + s * n[0] * n[0] * a; t[1] = s * b; t[2] = -s * n[0];
    u[0] = -b; u[1] = -(s + (double)n[1] * n[1] * a); u[2] = n[1];
    for (k = 0; k < 3; k++) { right[k] = c * t[k] + d * u[k]; up[k] = c * u[k] - d * t[k]; }
}

/* Directions of view `face`: 0 looks along the normal, 1 to 4 to the sides with the normal up. */
static void sbl__view_axes(const sbl__site *p, int face, double right[3], double up[3], double forward[3]) {
    double t[3], u[3];
    int k;
    sbl__frame(p->normal, p->turn, t, u);
    for (k = 0; k < 3; k++) {
        double n = p->normal[k];
        forward[k] = face == 0 ? n : face == 1 ? t[k] : face == 2 ? u[k] : face == 3 ? -t[k] : -u[k];
        up[k] = face == 0 ? u[k] : n;
        right[k] = face == 0 ? t[k] : face == 1 ? u[k] : face == 2 ? -t[k] : face == 3 ? -u[k] : t[k];
    }
}

static void sbl__view_make(const sbl__layout *l, const sbl__site *p, int face, int corner_x, int corner_y, int atlas_width, int atlas_height, sbl__view *out) {
    double right[3], up[3], forward[3];
    const int *r = l->rects[face];
    int k;
    sbl__view_axes(p, face, right, up, forward);
    for (k = 0; k < 3; k++) {
        out->eye[k] = p->position[k];
        out->right[k] = (float)(right[k] / l->tangent);
        out->up[k] = (float)(up[k] / l->tangent);
        out->forward[k] = (float)forward[k];
    }
    out->right[3] = (float)r[2] / (float)atlas_width;
    out->offset[0] = (float)(2 * (corner_x + r[0]) + r[2]) / (float)atlas_width - 1;
    out->up[3] = (float)(face ? 2 * r[3] : r[3]) / (float)atlas_height;
    out->offset[1] = (float)(2 * (corner_y + r[1]) + (face ? 0 : r[3])) / (float)atlas_height - 1;
    out->forward[3] = face ? 0.0f : -1.0f;
}

/* The range of x and y, in tangents, that a view's rectangle spans. */
static void sbl__view_range(const sbl__layout *l, int face, double range[4]) {
    range[0] = -l->tangent; range[1] = l->tangent;
    range[2] = face ? 0 : -l->tangent; range[3] = l->tangent;
}

/* Projected solid angle over pi of the corner rectangle [0, x] x [0, y] at unit distance. Top: in a plane across the normal; the integral of
   1 / (pi (1 + x^2 + y^2)^2). Side: in a plane along the normal, y up; the integral of y / (pi (1 + x^2 + y^2)^2), less its value at y = 0.
   These are the form factors of Cohen and Greenberg 1985, "The Hemi-Cube", integrated. */
static double sbl__corner_top(double x, double y) {
    double a = sqrt(1 + x * x), b = sqrt(1 + y * y);
    return (x / a * atan(y / a) + y / b * atan(x / b)) / (2 * SBL__PI);
}

static double sbl__corner_side(double x, double y) {
    double b = sqrt(1 + y * y);
    return (atan(x) - atan(x / b) / b) / (2 * SBL__PI);
}

/* The paper's V'' of equation 4: onto the unit sphere, then down onto the tangent plane. */
static void sbl__paper_project(double x, double y, double out[2]) {
    double length = sqrt(x * x + y * y + 1);
    out[0] = x / length;
    out[1] = y / length;
}

/* weights: two floats a texel of the padded sheet: share of the hemisphere's projected solid angle; length of the texel's ray at unit depth. */
static void sbl__weights_make(const sbl__layout *l, int paper, float *weights) {
    size_t pitch = (size_t)(l->blocks[0] * l->block);
    int face, i, j;
    for (face = 0; face < l->view_count; face++) {
        const int *r = l->rects[face];
        double range[4], dx, dy;
        sbl__view_range(l, face, range);
        dx = (range[1] - range[0]) / r[2];
        dy = (range[3] - range[2]) / r[3];
        for (j = 0; j < r[3]; j++)
            for (i = 0; i < r[2]; i++) {
                float *out = weights + 2 * ((size_t)(r[1] + j) * pitch + (size_t)(r[0] + i));
                double x0 = range[0] + i * dx, y0 = range[2] + j * dy, x1 = x0 + dx, y1 = y0 + dy, x = x0 + 0.5 * dx, y = y0 + 0.5 * dy;
                if (paper) {  /* equation 4 over pi; section III-E's factor rdx * rdy and the mean over as many texels cancel */
                    double v0[2], v1[2], v2[2];
                    sbl__paper_project(x0, y0, v0);
                    sbl__paper_project(x1, y0, v1);
                    sbl__paper_project(x0, y1, v2);
                    out[0] = (float)(fabs((v1[0] - v0[0]) * (v2[1] - v0[1]) - (v1[1] - v0[1]) * (v2[0] - v0[0])) / SBL__PI);
                } else if (face)
                    out[0] = (float)(sbl__corner_side(x1, y1) - sbl__corner_side(x0, y1) - sbl__corner_side(x1, y0) + sbl__corner_side(x0, y0));
                else out[0] = (float)(sbl__corner_top(x1, y1) - sbl__corner_top(x0, y1) - sbl__corner_top(x1, y0) + sbl__corner_top(x0, y0));
                out[1] = (float)sqrt(1 + x * x + y * y);
            }
    }
}

/* ======================================================================================================== >>gather
   The primitive: points and normals in, light out. It does not know what the points are for, and nothing above knows how it sees.

   This back end rasterises. Sensor i of a job stands in slot i % slots of the atlas, whatever the batch: a picture never depends on it.

       atlas  +-------+-------+-------+      one instanced draw: every view of every sensor of a batch
              | sheet | sheet | sheet |
              +-------+-------+-------+      reduce_blocks: block x block texels -> one        (atlas -> block sums)
              | sheet |  ...          |      reduce_sum:    the blocks of a sheet -> one       (block sums -> results)
              +-------+---------------+      one readback for the whole job                                            */

#define SBL__RESULTS_WIDTH 1024
#define SBL__MAX_SLOTS 4096
#define SBL__DEPTH_SCALE 1e-6f  /* depth is this over distance, lengths in scene extents: surfaces nearer than it share depth 1 */

typedef struct sbl__reading {     /* what gather gives for a site: its reading */
    float radiance[3];          /* R */
    float back_share;           /* of the weight that sees surfaces, what sees back faces */
    float hit_share;            /* weight that sees surfaces */
    float hit_mean, hit_min;    /* distances, world units; 0 where nothing is seen */
    float noise;                /* standard error of R (mean of the channels) where it can be told: traced rays; else 0 */
    int stuck;                  /* set by refine: the sensor stands inside something, see sbl__refine_suspects */
} sbl__reading;

typedef struct sbl__gather {
    sbl__layout layout;
    int paper;
    float epsilon, radiance_scale;
    int columns, slots;
    sbl__texture atlas, depth, weights, block_sums, block_hits, lights, sums, hits;
    unsigned atlas_framebuffer, block_framebuffer, light_framebuffer, result_framebuffer;
    sbl__buffer view_buffer;
    sbl__view *views;           /* one batch, before it is sent */
    const sbl__site *sites;   /* the job; owned by the caller */
    int count, next;
    float spread;               /* traced: 1 for the hemisphere, 0 for rays along the normal only */
    int rays;                   /* traced: directions of a sensor; 0: rasterised */
    int lamp_rays;              /* at most so many more towards lamps; 0: there are none, or they are met by chance */
    int lamp_parts;             /* shader invocations that share them */
    int lamps_apart;            /* sensors' views and rays over the hemisphere do not see lamps */
    int environment;            /* sensors' views see the environment's picture */
    float length;               /* world units of a distance that the shaders give */
    sbl__buffer point_buffer, sequence_buffer;
    unsigned point_texels, sequence_texels;
    uint32_t *point_words;
    int draw_limit;             /* sensors in one draw that keep it short on any machine */
} sbl__gather;

static void sbl__gather_free(const sbl__gl *gl, sbl__gather *g) {
    sbl__name_delete(gl->DeleteFramebuffers, &g->atlas_framebuffer);
    sbl__name_delete(gl->DeleteFramebuffers, &g->block_framebuffer);
    sbl__name_delete(gl->DeleteFramebuffers, &g->light_framebuffer);
    sbl__name_delete(gl->DeleteFramebuffers, &g->result_framebuffer);
    sbl__texture_delete(gl, &g->atlas);
    sbl__texture_delete(gl, &g->depth);
    sbl__texture_delete(gl, &g->weights);
    sbl__texture_delete(gl, &g->block_sums);
    sbl__texture_delete(gl, &g->block_hits);
    sbl__texture_delete(gl, &g->lights);
    sbl__texture_delete(gl, &g->sums);
    sbl__texture_delete(gl, &g->hits);
    sbl__buffer_delete(gl, &g->view_buffer);
    sbl__name_delete(gl->DeleteTextures, &g->point_texels);
    sbl__name_delete(gl->DeleteTextures, &g->sequence_texels);
    sbl__buffer_delete(gl, &g->point_buffer);
    sbl__buffer_delete(gl, &g->sequence_buffer);
    sbl__free(gl->base, g->point_words);
    sbl__free(gl->base, g->views);
    memset(g, 0, sizeof *g);
}

/* Rays of one shader invocation: some software renderers end one silently after about 65,000 loop turns, of which a ray takes about the hierarchy's
   cost on average, and some times that in places. */
#define SBL__CHUNK 16
#define SBL__LAMP_CHUNK 256
#define SBL__LOOP_TURNS 20000
#define SBL__RAYS_A_DRAW 1000000 /* keeps a draw short on any machine */

/* The first `count` points of the Sobol sequence's first two dimensions (Joe and Kuo 2008), 32-bit fractions. */
static void sbl__sobol(uint32_t *out, int count) {
    int i, bit;
    for (i = 0; i < count; i++) {
        uint32_t x = 0, y = 0, direction = 0x80000000u;
        for (bit = 0; bit < 32; bit++, direction ^= direction >> 1)
            if ((uint32_t)i >> bit & 1u) { x |= 0x80000000u >> bit; y ^= direction; }
        out[2 * i] = x;
        out[2 * i + 1] = y;
    }
}

/* Along a Morton curve: rays that a shader traces side by side then go close by each other, whatever the scramble. */
static int sbl__morton_order(const void *first, const void *second) {
    const uint32_t *a = (const uint32_t *)first, *b = (const uint32_t *)second;
    uint32_t x = a[0] ^ b[0], y = a[1] ^ b[1];
    int axis = x < y && x < (x ^ y);  /* which differs in the higher bit */
    return a[axis] == b[axis] ? 0 : a[axis] < b[axis] ? -1 : 1;
}

/* What both back ends need to send rays, or looks towards lamps: their sequences, the points' words, a place for the lamps' light. */
static sbl_result sbl__rays_setup(const sbl__gl *gl, sbl__gather *g, int rays, int lamp_rays, int lamp_chunk, int rows) {
    const char *what = "making the rays' textures";
    const sbl__texture *color = &g->lights;
    size_t points = (size_t)(rays + lamp_rays) * SBL__MAX_LOOKS;
    uint32_t *sequence, *lamp_sequence;
    int i, k, chunks;
    sbl_result result;
    g->rays = rays;
    g->lamp_rays = lamp_rays;
    g->lamp_parts = (lamp_rays + lamp_chunk - 1) / lamp_chunk;
    if (!points) return SBL_SUCCESS;
    sequence = (uint32_t *)sbl__alloc(gl->base, points, 8);
    sbl__free(gl->base, g->point_words);
    g->point_words = (uint32_t *)sbl__alloc(gl->base, (size_t)g->draw_limit, 48);
    if (!sequence || !g->point_words) { sbl__free(gl->base, sequence); return SBL_ERROR_OUT_OF_MEMORY; }
    lamp_sequence = sequence + 2 * (size_t)rays * SBL__MAX_LOOKS;
    sbl__sobol(sequence, rays * SBL__MAX_LOOKS);
    sbl__sobol(lamp_sequence, lamp_rays * SBL__MAX_LOOKS);
    for (i = 0; i < SBL__MAX_LOOKS; i++) {
        qsort(sequence + 2 * (size_t)rays * (size_t)i, (size_t)rays, 8, sbl__morton_order);
        for (k = 0, chunks = 8 * g->lamp_parts; k < chunks; k++) {  /* lamps.glsl may stop after each: it must cover all evenly */
            size_t from = (size_t)lamp_rays * (size_t)k / (size_t)chunks, to = (size_t)lamp_rays * (size_t)(k + 1) / (size_t)chunks;
            if (to > from) qsort(lamp_sequence + 2 * ((size_t)lamp_rays * (size_t)i + from), to - from, 8, sbl__morton_order);
        }
    }
    gl->BindVertexArray(0);
    result = sbl__buffer_make(gl, &g->sequence_buffer, 8 * points, sequence, SBL__GL_STATIC_DRAW, what);
    sbl__free(gl->base, sequence);
    if (result == SBL_SUCCESS) result = sbl__buffer_texture_make(gl, &g->sequence_texels, SBL__GL_RG32UI, &g->sequence_buffer, what);
    if (result == SBL_SUCCESS && lamp_rays) result = sbl__texture_make(gl, &g->lights, g->columns, rows * g->lamp_parts, SBL__GL_RGBA32F, NULL, what);
    if (result == SBL_SUCCESS && lamp_rays) result = sbl__framebuffer_make(gl, &g->light_framebuffer, &color, 1, NULL, what);
    return result;
}

/* Sets up for sensors of one kind and size. Keeps what an earlier set-up made where it fits. */
static sbl_result sbl__gather_setup(const sbl__gl *gl, sbl__gather *g, const sbl__scene *scene, int hemicube, int paper, int size, float fov, float epsilon, int lamp_rays, int atlas_size, int batch) {
    const char *what = "making the sensors' atlas";
    const sbl__texture *colors[2];
    int pitch[2], rows, limit;
    float *weights;
    double brightest;
    sbl_result result;
    sbl__layout_make(&g->layout, hemicube, size, fov);
    g->paper = paper;
    g->epsilon = epsilon;
    g->length = scene->extent;
    /* a power of two brings the brightest light near 1024: inside 16-bit floats, with room below */
    brightest = SBL__MAX(scene->max_radiance, epsilon);
    g->radiance_scale = brightest > 0 ? (float)ldexp(1, SBL__MIN(10 - (int)ceil(log(brightest) / log(2.0)), 100)) : 1;
    pitch[0] = g->layout.blocks[0] * g->layout.block;
    pitch[1] = g->layout.blocks[1] * g->layout.block;
    atlas_size = SBL__MIN(SBL__MAX(atlas_size, SBL__MAX(pitch[0], pitch[1])), gl->capabilities.max_texture_size);
    g->columns = atlas_size / pitch[0];
    rows = SBL__MIN(atlas_size / pitch[1], (SBL__MAX_SLOTS + g->columns - 1) / g->columns);
    if (g->columns < 1 || rows < 1) {
        sbl__log(gl->base, SBL_LOG_ERROR, SBL_LOG_ITEM_TOO_LARGE, "a sensor of size %d needs a texture of %d x %d, the driver has %d; use a smaller sensor_size", size, pitch[0], pitch[1], gl->capabilities.max_texture_size);
        return SBL_ERROR_UNSUPPORTED;
    }
    g->slots = g->columns * rows;
    limit = (int)(3e7 / (double)SBL__MAX(scene->triangle_count, 1) / g->layout.view_count);
    g->draw_limit = SBL__MAX(1, SBL__MIN(limit, batch > 0 ? SBL__MIN(batch, g->slots) : g->slots));

    weights = (float *)sbl__alloc(gl->base, (size_t)pitch[0] * (size_t)pitch[1], 8);
    if (!weights) return SBL_ERROR_OUT_OF_MEMORY;
    sbl__weights_make(&g->layout, paper, weights);
    result = sbl__texture_make(gl, &g->weights, pitch[0], pitch[1], SBL__GL_RG32F, weights, what);
    sbl__free(gl->base, weights);
    sbl__free(gl->base, g->views);
    g->views = (sbl__view *)sbl__alloc(gl->base, (size_t)g->draw_limit * (size_t)g->layout.view_count, sizeof(sbl__view));
    if (!g->views) return SBL_ERROR_OUT_OF_MEMORY;
    if (result == SBL_SUCCESS) result = sbl__texture_make(gl, &g->atlas, g->columns * pitch[0], rows * pitch[1], SBL__GL_RGBA16F, NULL, what);
    if (result == SBL_SUCCESS) result = sbl__texture_make(gl, &g->depth, g->columns * pitch[0], rows * pitch[1], SBL__GL_DEPTH_COMPONENT32F, NULL, what);
    if (result == SBL_SUCCESS) result = sbl__texture_make(gl, &g->block_sums, g->columns * g->layout.blocks[0], rows * g->layout.blocks[1], SBL__GL_RGBA32F, NULL, what);
    if (result == SBL_SUCCESS) result = sbl__texture_make(gl, &g->block_hits, g->columns * g->layout.blocks[0], rows * g->layout.blocks[1], SBL__GL_RGBA32F, NULL, what);
    colors[0] = &g->atlas;
    if (result == SBL_SUCCESS) result = sbl__framebuffer_make(gl, &g->atlas_framebuffer, colors, 1, &g->depth, what);
    colors[0] = &g->block_sums;
    colors[1] = &g->block_hits;
    if (result == SBL_SUCCESS) result = sbl__framebuffer_make(gl, &g->block_framebuffer, colors, 2, NULL, what);
    if (result == SBL_SUCCESS) result = sbl__rays_setup(gl, g, 0, lamp_rays, SBL__LAMP_CHUNK, rows);
    return result;
}

/* Starts a job: R for `count` points. The points must stay until sbl__gather_finish. */
static sbl_result sbl__gather_begin(const sbl__gl *gl, sbl__gather *g, const sbl__site *sites, int count) {
    const char *what = "making the sensors' results";
    const sbl__texture *colors[2];
    int rows = (count + SBL__RESULTS_WIDTH - 1) / SBL__RESULTS_WIDTH;
    sbl_result result = SBL_SUCCESS;
    g->sites = sites;
    g->count = count;
    g->next = 0;
    if (rows > gl->capabilities.max_texture_size) {
        sbl__log(gl->base, SBL_LOG_ERROR, SBL_LOG_ITEM_TOO_LARGE, "%d sensors in one job; the driver's textures hold %d; use a smaller picture", count, gl->capabilities.max_texture_size * SBL__RESULTS_WIDTH);
        return SBL_ERROR_UNSUPPORTED;
    }
    if (g->sums.height < rows || g->hits.height < rows) {
        result = sbl__texture_make(gl, &g->sums, SBL__RESULTS_WIDTH, rows, SBL__GL_RGBA32F, NULL, what);
        if (result == SBL_SUCCESS) result = sbl__texture_make(gl, &g->hits, SBL__RESULTS_WIDTH, rows, SBL__GL_RGBA32F, NULL, what);
        colors[0] = &g->sums;
        colors[1] = &g->hits;
        if (result == SBL_SUCCESS) result = sbl__framebuffer_make(gl, &g->result_framebuffer, colors, 2, NULL, what);
    }
    return result;
}

/* The host's own geometry, view by view. */
static void sbl__gather_draw_host(const sbl__gl *gl, const sbl__gather *g, const sbl__scene *scene, int first, int count) {
    int pitch_x = g->layout.blocks[0] * g->layout.block, pitch_y = g->layout.blocks[1] * g->layout.block, i, face, k;
    for (i = first; i < first + count; i++)
        for (face = 0; face < g->layout.view_count; face++) {
            const sbl__site *p = &g->sites[i];
            const int *r = g->layout.rects[face];
            int slot = i % g->slots;
            double right[3], up[3], forward[3], per_length = 1 / (double)scene->extent;
            sbl_draw_view v;
            memset(&v, 0, sizeof v);
            v.kind = SBL_VIEW_SENSOR;
            v.viewport[0] = slot % g->columns * pitch_x + r[0];
            v.viewport[1] = slot / g->columns * pitch_y + r[1];
            v.viewport[2] = r[2];
            v.viewport[3] = r[3];
            sbl__view_axes(p, face, right, up, forward);
            for (k = 0; k < 3; k++) {
                v.world_to_view[4 * k] = (float)right[k];
                v.world_to_view[4 * k + 1] = (float)up[k];
                v.world_to_view[4 * k + 2] = (float)-forward[k];
                v.world_to_view[12] -= (float)(right[k] * p->position[k]);
                v.world_to_view[13] -= (float)(up[k] * p->position[k]);
                v.world_to_view[14] += (float)(forward[k] * p->position[k]);
                v.eye[k] = p->position[k];
            }
            v.world_to_view[15] = 1;
            v.view_to_clip[0] = (float)(per_length / g->layout.tangent);
            v.view_to_clip[5] = (float)(per_length / g->layout.tangent) * (face ? 2.0f : 1.0f);
            v.view_to_clip[9] = face ? (float)per_length : 0.0f;  /* a side shows y from 0 to 1 */
            v.view_to_clip[11] = (float)-per_length;
            v.view_to_clip[14] = SBL__DEPTH_SCALE;
            sbl__multiply(v.world_to_clip, v.view_to_clip, v.world_to_view);
            v.radiance_scale = g->radiance_scale;
            v.depth_scale = SBL__DEPTH_SCALE;
            v.write_depth = !(gl->capabilities.used & SBL_CAPABILITY_CLIP_CONTROL);
            v.epsilon = g->epsilon;
            v.sensor = i;
            v.face = face;
            gl->BindFramebuffer(SBL__GL_DRAW_FRAMEBUFFER, g->atlas_framebuffer);
            gl->Enable(SBL__GL_DEPTH_TEST);
            gl->Enable(SBL__GL_SCISSOR_TEST);
            gl->Viewport(v.viewport[0], v.viewport[1], v.viewport[2], v.viewport[3]);
            gl->Scissor(v.viewport[0], v.viewport[1], v.viewport[2], v.viewport[3]);
            scene->draw(&v, scene->draw_user);
            sbl__guard_force(gl);
        }
}

/* Fills the atlas with sky. */
static void sbl__gather_clear(const sbl__gl *gl, const sbl__gather *g, const sbl__scene *scene) {
    float sky[4], zero = 0;
    int k;
    for (k = 0; k < 3; k++) sky[k] = scene->sky[k] * g->radiance_scale;
    sky[3] = 0;
    gl->BindFramebuffer(SBL__GL_DRAW_FRAMEBUFFER, g->atlas_framebuffer);
    gl->ClearBufferfv(SBL__GL_COLOR, 0, sky);
    gl->ClearBufferfv(SBL__GL_DEPTH, 0, &zero);
}

/* Draws sensors first .. first + count - 1, which lie in one filling of the atlas. programs: sensor, sky_view. */
static sbl_result sbl__gather_draw(const sbl__gl *gl, sbl__gather *g, const sbl__scene *scene, const unsigned programs[2], int first, int count) {
    const unsigned program = programs[0];
    const sbl__layout *l = &g->layout;
    int pitch_x = l->blocks[0] * l->block, pitch_y = l->blocks[1] * l->block, i, face;
    sbl_result result = SBL_SUCCESS;
    gl->BindFramebuffer(SBL__GL_DRAW_FRAMEBUFFER, g->atlas_framebuffer);
    gl->Viewport(0, 0, g->atlas.width, g->atlas.height);
    if (first % g->slots == 0) sbl__gather_clear(gl, g, scene);
    if (scene->triangle_count || (g->environment && scene->sky_pixels)) {
        for (i = 0; i < count; i++)
            for (face = 0; face < l->view_count; face++) {
                int slot = (first + i) % g->slots;
                sbl__view_make(l, &g->sites[first + i], face, slot % g->columns * pitch_x, slot / g->columns * pitch_y, g->atlas.width, g->atlas.height,
                               &g->views[i * l->view_count + face]);
            }
        result = sbl__buffer_make(gl, &g->view_buffer, (size_t)(count * l->view_count) * sizeof(sbl__view), g->views, SBL__GL_STREAM_DRAW, "sending views");
        if (result != SBL_SUCCESS) return result;
        gl->BindVertexArray(scene->vertex_array);
        gl->BindBuffer(SBL__GL_ARRAY_BUFFER, g->view_buffer.id);
        gl->VertexAttribPointer(4, 3, SBL__GL_FLOAT, 0, (int)sizeof(sbl__view), (const void *)offsetof(sbl__view, eye));
        gl->VertexAttribPointer(5, 4, SBL__GL_FLOAT, 0, (int)sizeof(sbl__view), (const void *)offsetof(sbl__view, right));
        gl->VertexAttribPointer(6, 4, SBL__GL_FLOAT, 0, (int)sizeof(sbl__view), (const void *)offsetof(sbl__view, up));
        gl->VertexAttribPointer(7, 4, SBL__GL_FLOAT, 0, (int)sizeof(sbl__view), (const void *)offsetof(sbl__view, forward));
        gl->VertexAttribPointer(8, 2, SBL__GL_FLOAT, 0, (int)sizeof(sbl__view), (const void *)offsetof(sbl__view, offset));
        for (i = 4; i <= 8; i++) {
            gl->EnableVertexAttribArray((unsigned)i);
            gl->VertexAttribDivisor((unsigned)i, 1);
        }
        if (g->environment && scene->sky_pixels) {
            gl->Disable(SBL__GL_DEPTH_TEST);
            gl->UseProgram(programs[1]);
            sbl__sky_bind(gl, scene, programs[1], 0);
            sbl__uniform_f(gl, programs[1], "radiance_scale", g->radiance_scale);
            gl->DrawArraysInstanced(SBL__GL_TRIANGLE_STRIP, 0, 4, count * l->view_count);
        }
        gl->Enable(SBL__GL_DEPTH_TEST);
        for (i = 0; i < 4; i++) gl->Enable(SBL__GL_CLIP_DISTANCE0 + (unsigned)i);
        gl->UseProgram(program);
        sbl__scene_bind(gl, scene, program);
        sbl__uniform_i(gl, program, "lamps_apart", g->lamps_apart);
        sbl__uniform_f(gl, program, "per_length", 1 / scene->extent);
        sbl__uniform_f(gl, program, "depth_scale", SBL__DEPTH_SCALE);
        sbl__uniform_f(gl, program, "epsilon", g->epsilon);
        sbl__uniform_f(gl, program, "radiance_scale", g->radiance_scale);
        gl->DrawElementsInstanced(SBL__GL_TRIANGLES, 3 * scene->triangle_count, SBL__GL_UNSIGNED_INT, NULL, count * l->view_count);
        for (i = 0; i < 4; i++) gl->Disable(SBL__GL_CLIP_DISTANCE0 + (unsigned)i);
    }
    if (scene->draw) sbl__gather_draw_host(gl, g, scene, first, count);
    return result;
}

/* Reduces the sensors of the atlas's present filling, the last of which is `last`. */
static void sbl__gather_reduce(const sbl__gl *gl, const sbl__gather *g, const unsigned programs[2], unsigned empty_array, int last) {
    int first = last - last % g->slots, used = last - first + 1, sheet_rows = (used + g->columns - 1) / g->columns;
    int row_first = first / SBL__RESULTS_WIDTH, row_last = last / SBL__RESULTS_WIDTH;
    gl->BindVertexArray(empty_array);
    gl->Disable(SBL__GL_DEPTH_TEST);
    if (!g->rays) {
        gl->BindFramebuffer(SBL__GL_DRAW_FRAMEBUFFER, g->block_framebuffer);
        gl->Viewport(0, 0, g->block_sums.width, sheet_rows * g->layout.blocks[1]);
        gl->UseProgram(programs[0]);
        sbl__bind(gl, programs[0], "atlas", 0, SBL__GL_TEXTURE_2D, g->atlas.id);
        sbl__bind(gl, programs[0], "weights", 1, SBL__GL_TEXTURE_2D, g->weights.id);
        sbl__uniform_i(gl, programs[0], "block", g->layout.block);
        gl->Uniform2i(sbl__uniform(gl, programs[0], "blocks"), g->layout.blocks[0], g->layout.blocks[1]);
        gl->DrawArrays(SBL__GL_TRIANGLES, 0, 3);
    }
    gl->BindFramebuffer(SBL__GL_DRAW_FRAMEBUFFER, g->result_framebuffer);
    gl->Viewport(0, row_first, SBL__RESULTS_WIDTH, row_last - row_first + 1);
    gl->UseProgram(programs[1]);
    sbl__bind(gl, programs[1], "block_sums", 0, SBL__GL_TEXTURE_2D, g->block_sums.id);
    sbl__bind(gl, programs[1], "block_hits", 1, SBL__GL_TEXTURE_2D, g->block_hits.id);
    sbl__bind(gl, programs[1], "lights", 2, SBL__GL_TEXTURE_2D, g->lamp_rays ? g->lights.id : g->block_sums.id);
    sbl__uniform_i(gl, programs[1], "parts", g->lamp_parts);
    gl->Uniform2i(sbl__uniform(gl, programs[1], "blocks"), g->layout.blocks[0], g->layout.blocks[1]);
    sbl__uniform_i(gl, programs[1], "columns", g->columns);
    sbl__uniform_i(gl, programs[1], "slots", g->slots);
    sbl__uniform_i(gl, programs[1], "width", SBL__RESULTS_WIDTH);
    sbl__uniform_i(gl, programs[1], "first", first);
    sbl__uniform_i(gl, programs[1], "last", last);
    gl->DrawArrays(SBL__GL_TRIANGLES, 0, 3);
    gl->Flush();
}

/* Sensors of so many rays over the hemisphere and at most so many to lamps; spread 0: rays along the normal only. */
static sbl_result sbl__trace_setup(const sbl__gl *gl, sbl__gather *g, const sbl__bvh *bvh, int rays, int lamp_rays, float spread, float epsilon, int batch) {
    const char *what = "making the rays' textures";
    const sbl__texture *colors[2];
    int most = SBL__MAX(1, (int)(SBL__LOOP_TURNS / (bvh->cost + 20))), few = SBL__MAX(1, most / 4), lamp_chunk = SBL__MIN(SBL__LAMP_CHUNK, most);
    int chunk = SBL__MIN(SBL__MIN(SBL__CHUNK, few), (rays + 7) / 8), chunks = (rays + chunk - 1) / chunk, rows;
    sbl_result result;
    memset(&g->layout, 0, sizeof g->layout);
    g->layout.view_count = 1;
    g->layout.blocks[0] = SBL__MIN(chunks, 4);
    g->layout.blocks[1] = (chunks + 3) / 4;
    g->lamps_apart = 1;
    g->spread = spread;
    g->epsilon = epsilon;
    g->length = g->radiance_scale = 1;
    g->columns = SBL__MAX(1, SBL__MIN(256, SBL__MIN(1024, gl->capabilities.max_texture_size) / g->layout.blocks[0]));
    rows = SBL__MAX(1, SBL__MIN(1024 / SBL__MAX(g->layout.blocks[1], (lamp_rays + lamp_chunk - 1) / lamp_chunk), SBL__MAX_SLOTS / g->columns));
    g->slots = g->columns * rows;
    g->draw_limit = SBL__MAX(1, SBL__MIN(SBL__RAYS_A_DRAW / (rays + lamp_rays), batch > 0 ? SBL__MIN(batch, g->slots) : g->slots));
    result = sbl__rays_setup(gl, g, rays, lamp_rays, lamp_chunk, rows);
    if (result == SBL_SUCCESS) result = sbl__texture_make(gl, &g->block_sums, g->columns * g->layout.blocks[0], rows * g->layout.blocks[1], SBL__GL_RGBA32F, NULL, what);
    if (result == SBL_SUCCESS) result = sbl__texture_make(gl, &g->block_hits, g->columns * g->layout.blocks[0], rows * g->layout.blocks[1], SBL__GL_RGBA32F, NULL, what);
    colors[0] = &g->block_sums;
    colors[1] = &g->block_hits;
    if (result == SBL_SUCCESS) result = sbl__framebuffer_make(gl, &g->block_framebuffer, colors, 2, NULL, what);
    return result;
}

#define SBL__WORKGROUP 64  /* as in traverse.glsl */

/* What programs that trace rays, or look towards lamps, read. */
static void sbl__trace_bind(const sbl__gl *gl, const sbl__gather *g, const sbl__scene *scene, unsigned program, int slot, int count) {
    gl->UseProgram(program);
    sbl__scene_bind(gl, scene, program);
    sbl__bind_texels(gl, program, "sbl_nodes", 6, &scene->node_texels);
    sbl__bind_texels(gl, program, "sbl_triangles", 7, &scene->triangle_texels);
    sbl__bind(gl, program, "sbl_points", 8, SBL__GL_TEXTURE_BUFFER, g->point_texels);
    sbl__bind(gl, program, "sbl_sequence", 9, SBL__GL_TEXTURE_BUFFER, g->sequence_texels);
    sbl__sky_bind(gl, scene, program, 11);
    sbl__uniform_3(gl, program, "grid_origin", scene->bvh.grid_origin);
    sbl__uniform_3(gl, program, "grid_per_length", scene->bvh.grid_per_length);
    sbl__uniform_i(gl, program, "node_count", scene->bvh.node_count);
    sbl__uniform_i(gl, program, "columns", g->columns);
    sbl__uniform_i(gl, program, "first_slot", slot);
    sbl__uniform_i(gl, program, "count", count);
}

/* Runs the program over `count` sensors from `slot` on, each of across x down texels. Sums are the same whichever carries them.
   Compute is used wherever it is, so that pictures depend on no stopwatch: it is as fast or faster on llvmpipe; neither was measured on a GPU yet. */
static void sbl__trace_run(const sbl__gl *gl, const sbl__gather *g, unsigned program, unsigned framebuffer, const sbl__texture *const targets[2], int across, int down, int slot, int count) {
    int row = slot / g->columns, last_row = (slot + count - 1) / g->columns, i;
    gl->Uniform2i(sbl__uniform(gl, program, "blocks"), across, down);
    if (gl->capabilities.used & SBL_CAPABILITY_COMPUTE) {
        for (i = 0; i < 2 && targets[i]; i++) gl->BindImageTexture((unsigned)i, targets[i]->id, 0, 0, 0, SBL__GL_WRITE_ONLY, SBL__GL_RGBA32F);
        (gl->MemoryBarrier)(SBL__GL_SHADER_IMAGE_ACCESS_BARRIER);  /* what reads the last sums must be done; parentheses: windows.h has such a macro */
        gl->DispatchCompute((unsigned)((count * across * down + SBL__WORKGROUP - 1) / SBL__WORKGROUP), 1, 1);
        (gl->MemoryBarrier)(SBL__GL_TEXTURE_FETCH_BARRIER | SBL__GL_FRAMEBUFFER_BARRIER);
    } else {
        gl->BindFramebuffer(SBL__GL_DRAW_FRAMEBUFFER, framebuffer);
        gl->Viewport(0, row * down, targets[0]->width, (last_row - row + 1) * down);
        gl->DrawArrays(SBL__GL_TRIANGLES, 0, 3);
    }
}

/* Sends sensors first .. first + count - 1 to the shaders that trace rays or look towards lamps. */
static sbl_result sbl__sites_send(const sbl__gl *gl, sbl__gather *g, int first, int count) {
    int i;
    sbl_result result;
    for (i = 0; i < count; i++) {
        const sbl__site *p = &g->sites[first + i];
        uint32_t *words = g->point_words + 12 * i;
        memcpy(words, p->position, 12);
        words[3] = sbl__hash(p->seed);
        if (!g->rays) memcpy(words + 3, &p->turn, 4);
        memcpy(words + 4, p->normal, 12);
        words[7] = sbl__hash(p->seed + 1u);
        words[8] = p->first_ray * (uint32_t)g->rays;
        words[9] = SBL__MAX_LOOKS * (uint32_t)g->rays + p->first_ray * (uint32_t)g->lamp_rays;
        words[10] = sbl__hash(p->seed + 2u);
        memcpy(words + 11, &p->offset, 4);
    }
    gl->BindVertexArray(0);
    result = sbl__buffer_make(gl, &g->point_buffer, 48 * (size_t)count, g->point_words, SBL__GL_STREAM_DRAW, "sending points");
    return result == SBL_SUCCESS ? sbl__buffer_texture_make(gl, &g->point_texels, SBL__GL_RGBA32UI, &g->point_buffer, "sending points") : result;
}

/* Light of lamps for `count` sensors from `slot` on, whose points were sent; rasterised ones have drawn their views. */
static void sbl__lamps_draw(const sbl__gl *gl, const sbl__gather *g, const sbl__scene *scene, unsigned program, unsigned empty_array, int slot, int count) {
    const sbl__texture *const lights[2] = { &g->lights, NULL };
    int i;
    gl->BindVertexArray(empty_array);
    gl->Disable(SBL__GL_DEPTH_TEST);
    sbl__trace_bind(gl, g, scene, program, slot, count);
    sbl__bind_texels(gl, program, "sbl_lamps", 10, &scene->lamp_texels);
    sbl__uniform_i(gl, program, "lamp_nodes", scene->lamp_nodes);
    sbl__uniform_i(gl, program, "lamp_leaves", scene->lamp_leaves);
    sbl__uniform_i(gl, program, "rays", g->lamp_rays);
    sbl__uniform_f(gl, program, "unit", scene->lamp_unit);
    sbl__uniform_f(gl, program, "scale", g->radiance_scale);
    if (!g->rays) {
        const sbl__layout *l = &g->layout;
        sbl__bind(gl, program, "atlas", 12, SBL__GL_TEXTURE_2D, g->atlas.id);
        for (i = 0; i < l->view_count; i++) {
            char name[32];
            snprintf(name, sizeof name, "view_rects[%d]", i);
            gl->Uniform4f(sbl__uniform(gl, program, name), (float)l->rects[i][0], (float)l->rects[i][1], (float)l->rects[i][2], (float)l->rects[i][3]);
        }
        gl->Uniform2i(sbl__uniform(gl, program, "sheet"), l->blocks[0] * l->block, l->blocks[1] * l->block);
        sbl__uniform_i(gl, program, "view_count", l->view_count);
        sbl__uniform_f(gl, program, "tangent", (float)l->tangent);
        sbl__uniform_f(gl, program, "extent", scene->extent);
    }
    sbl__trace_run(gl, g, program, g->light_framebuffer, lights, 1, g->lamp_parts, slot, count);
}

/* Traces sensors first .. first + count - 1, which lie in one filling of the block textures. programs: trace, lamps. */
static sbl_result sbl__trace_draw(const sbl__gl *gl, sbl__gather *g, const sbl__scene *scene, const unsigned programs[2], unsigned empty_array, int first, int count) {
    const sbl__texture *const parts[2] = { &g->block_sums, &g->block_hits };
    int slot = first % g->slots;
    sbl_result result = sbl__sites_send(gl, g, first, count);
    if (result != SBL_SUCCESS) return result;
    gl->BindVertexArray(empty_array);
    gl->Disable(SBL__GL_DEPTH_TEST);
    sbl__trace_bind(gl, g, scene, programs[0], slot, count);
    sbl__uniform_i(gl, programs[0], "rays", g->rays);
    sbl__uniform_i(gl, programs[0], "lamps_apart", g->lamps_apart);
    sbl__uniform_f(gl, programs[0], "epsilon", g->epsilon);
    sbl__uniform_f(gl, programs[0], "spread", g->spread);
    sbl__trace_run(gl, g, programs[0], g->block_framebuffer, parts, g->layout.blocks[0], g->layout.blocks[1], slot, count);
    if (g->lamp_rays) sbl__lamps_draw(gl, g, scene, programs[1], empty_array, slot, count);
    gl->Flush();
    return sbl__gl_check(gl, "tracing rays");
}

/* One bounded piece of the job: at most `limit` sensors. Done when next == count. draw_programs: trace, lamps; or sensor, sky, lamps. */
static sbl_result sbl__gather_step(const sbl__gl *gl, sbl__gather *g, const sbl__scene *scene, const unsigned *draw_programs, const unsigned reduce_programs[2], unsigned empty_array, int limit) {
    int slot = g->next % g->slots, count = SBL__MIN(SBL__MIN(g->count - g->next, g->slots - slot), SBL__MAX(1, SBL__MIN(limit, g->draw_limit)));
    sbl_result result = g->rays ? sbl__trace_draw(gl, g, scene, draw_programs, empty_array, g->next, count) : sbl__gather_draw(gl, g, scene, draw_programs, g->next, count);
    if (result == SBL_SUCCESS && !g->rays && g->lamp_rays) {
        result = sbl__sites_send(gl, g, g->next, count);
        if (result == SBL_SUCCESS) sbl__lamps_draw(gl, g, scene, draw_programs[2], empty_array, slot, count);
    }
    if (result != SBL_SUCCESS) return result;
    g->next += count;
    if (g->next == g->count || g->next % g->slots == 0) sbl__gather_reduce(gl, g, reduce_programs, empty_array, g->next - 1);
    return SBL_SUCCESS;
}

/* Ends the job: lights[i] is what point i receives. */
static sbl_result sbl__gather_finish(const sbl__gl *gl, sbl__gather *g, sbl__reading *readings) {
    int rows = (g->count + SBL__RESULTS_WIDTH - 1) / SBL__RESULTS_WIDTH, i, k;
    size_t floats = (size_t)rows * SBL__RESULTS_WIDTH * 4;
    float *data = (float *)sbl__alloc(gl->base, 2 * floats, sizeof(float));
    sbl_result result;
    if (!data) return SBL_ERROR_OUT_OF_MEMORY;
    result = sbl__read_pixels(gl, g->result_framebuffer, 0, &g->sums, rows, data, "reading sensors");
    if (result == SBL_SUCCESS) result = sbl__read_pixels(gl, g->result_framebuffer, 1, &g->hits, rows, data + floats, "reading sensors");
    for (i = 0; i < g->count && result == SBL_SUCCESS; i++) {
        const float *sum = data + 4 * (size_t)i, *hits = data + floats + 4 * (size_t)i;
        for (k = 0; k < 3; k++) readings[i].radiance[k] = sum[k] / g->radiance_scale;
        readings[i].hit_share = hits[0];
        readings[i].back_share = hits[0] > 0 ? sum[3] / hits[0] : 0;
        readings[i].hit_mean = hits[0] > 0 ? hits[1] / hits[0] * g->length : 0;
        readings[i].hit_min = hits[0] > 0 ? hits[2] * g->length : 0;
        readings[i].stuck = 0;
        readings[i].noise = 0;
        if (g->rays || g->lamp_rays) readings[i].noise = (float)sqrt((double)hits[3]) / g->radiance_scale;
    }
    sbl__free(gl->base, data);
    return result;
}

/* ======================================================================================================== >>refine
   Which points get sensors (section III-G), level by level, and what the other pixels get from them.

   A cell is a rectangle of pixels with sensors at its four corners. It is split where two corners that belong together differ by more than
   the threshold, or where some pixel inside belongs to no corner. Neighbours share corners; a sensor that a split puts on the edge
   of a neighbour tests that neighbour too, so that a shadow's edge is followed even where it slips between the corners.

       +-------+-------+      +---+---+-------+      o sensor of the first level
       o       o       o      o   *   o       o      * sensor that the split of the left cell adds; the right cell's
       |       |       |      *   *   *       |        interpolation is tested against the one on their common edge
       o       o       o      o   *   o       o                                                                      */

/* Sensors stand this share off their surface: of the scene's extent where depth buffers decide what is seen, of their own triangle's reach where
   rays do. Six times what float rounding needs (from 2.5e-7 down, spheres see themselves). */
#define SBL__OFFSET 1.5e-6f

typedef struct sbl__pixel {
    float position[3], normal[3], geometric_normal[3];
    float offset;             /* of its sensor, off the surface */
    float radiance[3], noise; /* of R and its standard error */
    uint32_t id;              /* 0: nothing is seen here */
    int job;                  /* index of the pixel's sensor in the running job */
    unsigned char level;      /* 0: interpolated, else 1 + level */
    unsigned char sensed;     /* 1: its own sensor's light stands in radiance */
    unsigned char invalid;    /* the sensor was stuck inside geometry */
    unsigned char queued;     /* a sensor is on its way */
} sbl__pixel;

#define SBL__CURVATURE_WEIGHT 8.0f  /* how much stricter the threshold is for what interpolation is known to miss */
#define SBL__NOISE_WEIGHT 4           /* differences count from twice the standard error on */
#define SBL__LEAST_NOISE 1e-12f       /* in the radiance map: above 0, below all that counts */
#define SBL__MAX_ROUNDS 24            /* of following edges into neighbours; bounds the transfers of a picture */
#define SBL__COVERAGE 0.75f   /* share of the bilinear weight that must belong: with less, light is extrapolated, badly */

typedef struct sbl__cell { int x0, y0, x1, y1; int level; int split; } sbl__cell;

typedef struct sbl__refine {
    int width, height, tile;
    int geometry_aware, relative;
    float threshold;
    uint32_t seed;
    sbl__pixel *pixels;
    sbl__cell *cells;
    int cell_count, cell_room;
    int fresh;                /* cells from here on have not been judged */
    int rounds;
    sbl__site *sites;       /* the job, its pixels, and its answers */
    int *site_pixels;
    sbl__reading *readings;
    int site_count, site_room;
    sbl__site *suspects;     /* sensors that may be stuck, looking back at their surface */
    sbl__reading *suspect_readings;
    int suspect_count;
    float floor;              /* radiance below which differences do not count, from the first level's mean */
} sbl__refine;

/* belongs.glsl, for the CPU */
static float sbl__belongs(const sbl__pixel *a, const sbl__pixel *b, int geometry_aware) {
    float d[3], off, apart, turn, plane;
    int k;
    if (a->id != b->id || a->id == 0) return 0;
    if (!geometry_aware || a == b) return 1;
    turn = (sbl__dot(a->normal, b->normal) - 0.8f) / 0.2f;
    if (turn <= 0) return 0;
    turn = SBL__MIN(turn, 1.0f);
    for (k = 0; k < 3; k++) d[k] = b->position[k] - a->position[k];
    off = SBL__MAX((float)fabs((double)sbl__dot(d, a->normal)), (float)fabs((double)sbl__dot(d, b->normal)));
    apart = (float)sqrt((double)sbl__dot(d, d));
    plane = 2 - 8 * off / SBL__MAX(apart, 1e-30f);
    return turn * turn * SBL__MIN(SBL__MAX(plane, 0.0f), 1.0f);
}

/* Can its light be used for others? */
static int sbl__usable(const sbl__pixel *p) { return p->sensed && !p->invalid; }

/* Is the difference between two radiances worth more sensors? Not what their noise (its variance) explains. */
static int sbl__differ(const sbl__refine *r, const float a[3], const float b[3], double variance) {
    float most = 0, mean = 0, least;
    int k;
    for (k = 0; k < 3; k++) {
        most = SBL__MAX(most, (float)fabs((double)a[k] - b[k]));
        mean = SBL__MAX(mean, 0.5f * (a[k] + b[k]));
    }
    least = r->threshold * (r->relative ? mean + r->floor : 1.0f);
    return (double)most * most > (double)least * least + SBL__NOISE_WEIGHT * variance;
}

/* Light at pixel (x, y) from a cell's corners, and its noise; out may be NULL. Returns how well the corners cover it, 0 to 1. */
static float sbl__interpolate(const sbl__refine *r, const sbl__cell *c, int x, int y, float out[4]) {
    const sbl__pixel *pixel = &r->pixels[(size_t)y * (size_t)r->width + (size_t)x];
    float fx = c->x1 > c->x0 ? (float)(x - c->x0) / (float)(c->x1 - c->x0) : 0, fy = c->y1 > c->y0 ? (float)(y - c->y0) / (float)(c->y1 - c->y0) : 0;
    float sum[3] = { 0, 0, 0 }, variance = 0, weights = 0;
    int corner, k;
    for (corner = 0; corner < 4; corner++) {
        const sbl__pixel *p = &r->pixels[(size_t)(corner & 2 ? c->y1 : c->y0) * (size_t)r->width + (size_t)(corner & 1 ? c->x1 : c->x0)];
        float weight = (corner & 1 ? fx : 1 - fx) * (corner & 2 ? fy : 1 - fy);
        if (weight <= 0 || !sbl__usable(p)) continue;
        weight *= sbl__belongs(pixel, p, r->geometry_aware);
        for (k = 0; k < 3; k++) sum[k] += weight * p->radiance[k];
        variance += weight * weight * p->noise * p->noise;
        weights += weight;
    }
    if (out && weights > 0) {
        for (k = 0; k < 3; k++) out[k] = sum[k] / weights;
        out[3] = (float)sqrt((double)variance) / weights;
    }
    return weights;
}

static sbl_result sbl__refine_add_cell(sbl__base *base, sbl__refine *r, int x0, int y0, int x1, int y1, int level) {
    sbl__cell *c;
    if (r->cell_count == r->cell_room) {
        int room = r->cell_room * 2 + 1024;
        sbl__cell *cells = (sbl__cell *)sbl__alloc(base, (size_t)room, sizeof *cells);
        if (!cells) return SBL_ERROR_OUT_OF_MEMORY;
        if (r->cell_count) memcpy(cells, r->cells, (size_t)r->cell_count * sizeof *cells);
        sbl__free(base, r->cells);
        r->cells = cells;
        r->cell_room = room;
    }
    c = &r->cells[r->cell_count++];
    c->x0 = x0; c->y0 = y0; c->x1 = x1; c->y1 = y1;
    c->level = level;
    c->split = 0;
    return SBL_SUCCESS;
}

/* Pixels that a cell answers for: up to its right and lower edge, with them at the picture's border. */
static int sbl__cell_end_x(const sbl__refine *r, const sbl__cell *c) { return c->x1 == r->width - 1 ? c->x1 : c->x1 - 1; }
static int sbl__cell_end_y(const sbl__refine *r, const sbl__cell *c) { return c->y1 == r->height - 1 ? c->y1 : c->y1 - 1; }

/* How the light bends along a cell's edge: second differences at its two corners, over sensors as far beyond them. Returns how many there are,
   and the variance of each; neighbours that are alike may still have a peak between them. */
static int sbl__edge_bends(const sbl__refine *r, int x0, int y0, int x1, int y1, float bends[2][3], float variances[2]) {
    int dx = x1 - x0, dy = y1 - y0, ends = 0, end, k;
    const sbl__pixel *a = &r->pixels[(size_t)y0 * (size_t)r->width + (size_t)x0], *b = &r->pixels[(size_t)y1 * (size_t)r->width + (size_t)x1];
    if (dx + dy <= 1 || !r->geometry_aware || !sbl__usable(a) || !sbl__usable(b) || !(sbl__belongs(a, b, 1) > 0)) return 0;
    for (end = 0; end < 2; end++) {
        int x = end ? x1 + dx : x0 - dx, y = end ? y1 + dy : y0 - dy;
        const sbl__pixel *p = &r->pixels[(size_t)y * (size_t)r->width + (size_t)x], *near = end ? b : a, *far = end ? a : b;
        if (x < 0 || y < 0 || x >= r->width || y >= r->height || !sbl__usable(p) || !(sbl__belongs(near, p, 1) > 0)) continue;
        for (k = 0; k < 3; k++) bends[ends][k] = p->radiance[k] - 2 * near->radiance[k] + far->radiance[k];
        variances[ends++] = p->noise * p->noise + 4 * near->noise * near->noise + far->noise * far->noise;
    }
    return ends;
}

/* Bends it so much that a straight line misses its middle? */
static int sbl__edge_curved(const sbl__refine *r, int x0, int y0, int x1, int y1) {
    const sbl__pixel *a = &r->pixels[(size_t)y0 * (size_t)r->width + (size_t)x0], *b = &r->pixels[(size_t)y1 * (size_t)r->width + (size_t)x1];
    float bends[2][3], variances[2], straight[3], curved[3], weight;
    int ends = sbl__edge_bends(r, x0, y0, x1, y1, bends, variances), k;
    if (!ends) return 0;
    weight = SBL__CURVATURE_WEIGHT / (float)(8 * ends);  /* a parabola's middle lies an eighth of its second difference off the line */
    for (k = 0; k < 3; k++) {
        straight[k] = 0.5f * (a->radiance[k] + b->radiance[k]);
        curved[k] = straight[k] - weight * (bends[0][k] + (ends > 1 ? bends[1][k] : 0));
    }
    return sbl__differ(r, straight, curved, weight * weight * (variances[0] + (ends > 1 ? variances[1] : 0)));
}

/* The second difference that interpolation along an edge goes by: the lesser of the two where they agree, since at a kink they do not. */
static void sbl__edge_parabola(const sbl__refine *r, int x0, int y0, int x1, int y1, float out[3]) {
    float bends[2][3], variances[2];
    int ends = sbl__edge_bends(r, x0, y0, x1, y1, bends, variances), k;
    for (k = 0; k < 3; k++) {
        float a = ends ? bends[0][k] : 0, b = ends > 1 ? bends[1][k] : 0;
        out[k] = a * b <= 0 ? 0 : fabs((double)a) < fabs((double)b) ? a : b;
    }
}

static int sbl__cell_must_split(const sbl__refine *r, const sbl__cell *c) {
    const sbl__pixel *corners[4];
    int i, k, x, y;
    if (c->x1 - c->x0 <= 1 && c->y1 - c->y0 <= 1) return 0;
    for (i = 0; i < 4; i++) corners[i] = &r->pixels[(size_t)(i & 2 ? c->y1 : c->y0) * (size_t)r->width + (size_t)(i & 1 ? c->x1 : c->x0)];
    for (i = 0; i < 4; i++)
        for (k = i + 1; k < 4; k++)
            if (sbl__usable(corners[i]) && sbl__usable(corners[k]) && sbl__belongs(corners[i], corners[k], r->geometry_aware) > 0 &&
                sbl__differ(r, corners[i]->radiance, corners[k]->radiance, corners[i]->noise * corners[i]->noise + corners[k]->noise * corners[k]->noise)) return 1;
    if (sbl__edge_curved(r, c->x0, c->y0, c->x1, c->y0) || sbl__edge_curved(r, c->x0, c->y1, c->x1, c->y1) ||
        sbl__edge_curved(r, c->x0, c->y0, c->x0, c->y1) || sbl__edge_curved(r, c->x1, c->y0, c->x1, c->y1)) return 1;
    for (y = c->y0; y <= sbl__cell_end_y(r, c); y++)
        for (x = c->x0; x <= sbl__cell_end_x(r, c); x++) {
            const sbl__pixel *p = &r->pixels[(size_t)y * (size_t)r->width + (size_t)x];
            if (p->id && !p->sensed && sbl__interpolate(r, c, x, y, NULL) < SBL__COVERAGE) return 1;
        }
    return 0;
}

/* Does a sensor on the cell's rim contradict what the cell would have put there? Corners are skipped: they are the cell's own. */
static int sbl__cell_contradicted(const sbl__refine *r, const sbl__cell *c) {
    int side, i;
    if (c->x1 - c->x0 <= 1 && c->y1 - c->y0 <= 1) return 0;
    for (side = 0; side < 4; side++) {
        int length = side & 1 ? c->y1 - c->y0 : c->x1 - c->x0;
        for (i = 1; i < length; i++) {
            int x = side == 0 || side == 2 ? c->x0 + i : side == 1 ? c->x0 : c->x1;
            int y = side == 1 || side == 3 ? c->y0 + i : side == 0 ? c->y0 : c->y1;
            const sbl__pixel *p = &r->pixels[(size_t)y * (size_t)r->width + (size_t)x];
            float guess[4];
            if (sbl__usable(p) && sbl__interpolate(r, c, x, y, guess) > 0 && sbl__differ(r, guess, p->radiance, guess[3] * guess[3] + p->noise * p->noise)) return 1;
        }
    }
    return 0;
}

static sbl_result sbl__cell_split(sbl__base *base, sbl__refine *r, int index) {
    sbl__cell c = r->cells[index];
    int xm = (c.x0 + c.x1) / 2, ym = (c.y0 + c.y1) / 2, i, j;
    int xs[3], ys[3], columns = c.x1 - c.x0 > 1 ? 2 : 1, rows = c.y1 - c.y0 > 1 ? 2 : 1;
    sbl_result result = SBL_SUCCESS;
    xs[0] = c.x0; xs[1] = columns == 2 ? xm : c.x1; xs[2] = c.x1;
    ys[0] = c.y0; ys[1] = rows == 2 ? ym : c.y1; ys[2] = c.y1;
    r->cells[index].split = 1;
    for (j = 0; j < rows && result == SBL_SUCCESS; j++)
        for (i = 0; i < columns && result == SBL_SUCCESS; i++)
            result = sbl__refine_add_cell(base, r, xs[i], ys[j], xs[i + 1], ys[j + 1], c.level + 1);
    return result;
}

/* How often a sensor looks, each time turned a little further, outside paper mode. One that stands for many pixels is worth the more: what noise it
   has left would show as blotches the size of its tile. */
static int sbl__looks(const sbl__refine *r, int level) {
    int tile = level < 31 ? r->tile >> level : 0;
    return !r->geometry_aware ? 1 : tile >= 8 ? 4 : tile >= 4 ? 2 : 1;
}

/* The sensor of pixel number `index`: off the surface along the geometric normal, turned by the pixel's hash and the look, or (paper) not. */
static void sbl__refine_site(const sbl__refine *r, int index, double look, sbl__site *out) {
    const sbl__pixel *p = &r->pixels[index];
    int k;
    for (k = 0; k < 3; k++) {
        out->position[k] = p->position[k] + p->offset * p->geometric_normal[k];
        out->normal[k] = p->normal[k];
    }
    out->offset = p->offset;
    out->turn = r->geometry_aware ? (float)(0.5 * SBL__PI * (sbl__hash((uint32_t)index ^ sbl__hash(r->seed)) / 4294967296.0 + look)) : 0;
    out->seed = sbl__hash((uint32_t)index ^ sbl__hash(r->seed));
    out->first_ray = (uint32_t)(look * SBL__MAX_LOOKS);
}

/* Queues sensors for the corners of the cells not judged yet. Their number is r->site_count. */
static sbl_result sbl__refine_collect(sbl__base *base, sbl__refine *r) {
    int i, corner, look;
    r->site_count = 0;
    for (i = r->fresh; i < r->cell_count; i++) {
        const sbl__cell *c = &r->cells[i];
        for (corner = 0; corner < 4; corner++) {
            int x = corner & 1 ? c->x1 : c->x0, y = corner & 2 ? c->y1 : c->y0, index = y * r->width + x;
            sbl__pixel *p = &r->pixels[index];
            if (!p->id || p->sensed || p->queued) continue;
            if (r->site_count + SBL__MAX_LOOKS > r->site_room) {
                int room = r->site_room * 2 + 1024;
                sbl__site *sites = (sbl__site *)sbl__alloc(base, (size_t)room, sizeof *sites);
                int *pixels = (int *)sbl__alloc(base, (size_t)room, sizeof *pixels);
                sbl__reading *readings = (sbl__reading *)sbl__alloc(base, (size_t)room, sizeof *readings);
                if (!sites || !pixels || !readings) {
                    sbl__free(base, sites); sbl__free(base, pixels); sbl__free(base, readings);
                    return SBL_ERROR_OUT_OF_MEMORY;
                }
                if (r->site_count) {
                    memcpy(sites, r->sites, (size_t)r->site_count * sizeof *sites);
                    memcpy(pixels, r->site_pixels, (size_t)r->site_count * sizeof *pixels);
                }
                sbl__free(base, r->sites); sbl__free(base, r->site_pixels); sbl__free(base, r->readings);
                r->sites = sites; r->site_pixels = pixels; r->readings = readings;
                r->site_room = room;
            }
            p->queued = 1;
            p->level = (unsigned char)(1 + SBL__MIN(c->level, SBL_MAX_LEVELS - 1));
            p->job = r->site_count;
            for (look = 0; look < sbl__looks(r, c->level); look++) {
                r->site_pixels[r->site_count] = index;
                sbl__refine_site(r, index, (double)look / sbl__looks(r, c->level), &r->sites[r->site_count++]);
            }
        }
    }
    return SBL_SUCCESS;
}

/* A sensor is stuck when the little way it was moved off its surface took it through another: it then stands inside something that the visible point is
   outside of. What it sees tells little: whole rooms are modelled inside out, and what shines inside a thing may hide its walls. So a sensor that
   sees any back faces is asked to look back to where it came from, in a narrow view of its own, and is stuck when it sees something nearer than
   its own surface. */
#define SBL__SUSPECT_SHARE 0.02f
#define SBL__PROBE_FOV 2.0f      /* degrees: wide enough to meet the surface, too narrow to meet the walls of a corner */
#define SBL__PROBE_SIZE 4

static void sbl__probe_site(const sbl__refine *r, int index, const sbl__site *sensor, sbl__site *out) {
    int k;
    *out = *sensor;
    for (k = 0; k < 3; k++) out->normal[k] = -r->pixels[index].geometric_normal[k];
}

static int sbl__probe_stuck(const sbl__pixel *pixel, const sbl__reading *probe) { return probe->hit_share > 0 && probe->hit_min < 0.75f * pixel->offset; }

/* Lists the job's sensors that must look back. */
static sbl_result sbl__refine_suspects(sbl__base *base, sbl__refine *r) {
    int i;
    r->suspect_count = 0;
    for (i = 0; i < r->site_count; i++) r->suspect_count += r->readings[i].back_share > SBL__SUSPECT_SHARE;
    if (!r->suspect_count) return SBL_SUCCESS;
    r->suspects = (sbl__site *)sbl__alloc(base, (size_t)r->suspect_count, sizeof(sbl__site));
    r->suspect_readings = (sbl__reading *)sbl__alloc(base, (size_t)r->suspect_count, sizeof(sbl__reading));
    if (!r->suspects || !r->suspect_readings) return SBL_ERROR_OUT_OF_MEMORY;
    r->suspect_count = 0;
    for (i = 0; i < r->site_count; i++)
        if (r->readings[i].back_share > SBL__SUSPECT_SHARE) sbl__probe_site(r, r->site_pixels[i], &r->sites[i], &r->suspects[r->suspect_count++]);
    return SBL_SUCCESS;
}

static void sbl__refine_convict(sbl__base *base, sbl__refine *r) {
    int i, k = 0;
    for (i = 0; i < r->site_count && r->suspect_count; i++)
        if (r->readings[i].back_share > SBL__SUSPECT_SHARE) r->readings[i].stuck = sbl__probe_stuck(&r->pixels[r->site_pixels[i]], &r->suspect_readings[k++]);
    sbl__free(base, r->suspects);
    sbl__free(base, r->suspect_readings);
    r->suspects = NULL;
    r->suspect_readings = NULL;
    r->suspect_count = 0;
}

/* Takes the answers of the job, then judges cells: the fresh ones, and older ones that new sensors contradict. */
static sbl_result sbl__refine_judge(sbl__base *base, sbl__refine *r, sbl_stats *stats) {
    int i, k, look, looks = 1, sensors = 0, end = r->cell_count;
    double mean = 0;
    sbl_result result = SBL_SUCCESS;
    for (i = 0; i < r->site_count; i += looks) {
        sbl__pixel *p = &r->pixels[r->site_pixels[i]];
        float variance = 0;
        looks = sbl__looks(r, p->level - 1);
        for (k = 0; k < 3; k++) {
            float sum = 0;
            for (look = 0; look < looks; look++) sum += r->readings[i + look].radiance[k];
            p->radiance[k] = sum / (float)looks;
            mean += (double)p->radiance[k] / 3;
        }
        for (look = 0; look < looks; look++) variance += r->readings[i + look].noise * r->readings[i + look].noise;
        p->noise = (float)sqrt((double)variance) / (float)looks;
        p->sensed = 1;
        p->queued = 0;
        p->invalid = (unsigned char)r->readings[i].stuck;
        stats->invalid_sensors += p->invalid;
        stats->levels[p->level - 1].sensors++;
        stats->level_count = SBL__MAX(stats->level_count, p->level);
        stats->sensors++;
        sensors++;
    }
    if (r->rounds == 0) r->floor = sensors ? (float)(0.02 * mean / sensors) : 0;
    r->rounds++;
    for (i = 0; i < end && result == SBL_SUCCESS; i++) {
        const sbl__cell *c = &r->cells[i];
        if (c->split) continue;
        if (i >= r->fresh ? sbl__cell_must_split(r, c) : r->rounds <= SBL__MAX_ROUNDS && sbl__cell_contradicted(r, c)) result = sbl__cell_split(base, r, i);
    }
    r->fresh = end;
    return result;
}

/* Light and noise from those of the eight neighbours that have some (a > 0) and belong to pixel (x, y). Returns 0 where none does. */
static int sbl__refine_spread(const sbl__refine *r, const float *rgba, int x, int y, float out[4]) {
    const sbl__pixel *pixel = &r->pixels[(size_t)y * (size_t)r->width + (size_t)x];
    float sum[4] = { 0, 0, 0, 0 }, weights = 0;
    int i, j, k;
    for (j = SBL__MAX(y - 1, 0); j <= SBL__MIN(y + 1, r->height - 1); j++)
        for (i = SBL__MAX(x - 1, 0); i <= SBL__MIN(x + 1, r->width - 1); i++) {
            size_t at = (size_t)j * (size_t)r->width + (size_t)i;
            float weight = rgba[4 * at + 3] > 0 ? sbl__belongs(pixel, &r->pixels[at], r->geometry_aware) : 0;
            for (k = 0; k < 4 && weight > 0; k++) sum[k] += weight * rgba[4 * at + (size_t)k];
            weights += weight;
        }
    for (k = 0; k < 4 && weights > 0; k++) out[k] = sum[k] / weights;
    return weights > 0;
}

/* Fills the pixels without sensors. rgba: the radiance map, a = its noise, above 0 where there is a surface. Pixels whose own sensor is stuck and that no cell covers
   take the light that spreads over their surface from others, ring by ring; without any they keep what the stuck sensor saw. */
static sbl_result sbl__refine_fill(sbl__base *base, const sbl__refine *r, float *rgba) {
    int i, k, x, y, left = 0, before;
    int *orphans;
    float *found;
    size_t pixels = (size_t)r->width * (size_t)r->height, at;
    for (i = 0; i < r->cell_count; i++) {
        const sbl__cell *c = &r->cells[i];
        float bends[4][3];
        if (c->split) continue;
        sbl__edge_parabola(r, c->x0, c->y0, c->x1, c->y0, bends[0]);
        sbl__edge_parabola(r, c->x0, c->y1, c->x1, c->y1, bends[1]);
        sbl__edge_parabola(r, c->x0, c->y0, c->x0, c->y1, bends[2]);
        sbl__edge_parabola(r, c->x1, c->y0, c->x1, c->y1, bends[3]);
        for (y = c->y0; y <= sbl__cell_end_y(r, c); y++)
            for (x = c->x0; x <= sbl__cell_end_x(r, c); x++) {
                const sbl__pixel *p;
                at = (size_t)y * (size_t)r->width + (size_t)x;
                p = &r->pixels[at];
                if (!p->id) continue;
                if (sbl__usable(p)) {
                    memcpy(rgba + 4 * at, p->radiance, 3 * sizeof(float));
                    rgba[4 * at + 3] = p->noise;
                } else {
                    float fx = c->x1 > c->x0 ? (float)(x - c->x0) / (float)(c->x1 - c->x0) : 0, fy = c->y1 > c->y0 ? (float)(y - c->y0) / (float)(c->y1 - c->y0) : 0;
                    float covered = sbl__interpolate(r, c, x, y, rgba + 4 * at);
                    if (!(covered > 0)) { left++; continue; }
                    for (k = 0; k < 3; k++) {
                        float across = 0.5f * fx * (1 - fx) * (bends[0][k] + fy * (bends[1][k] - bends[0][k])), down = 0.5f * fy * (1 - fy) * (bends[2][k] + fx * (bends[3][k] - bends[2][k]));
                        rgba[4 * at + (size_t)k] = SBL__MAX(rgba[4 * at + (size_t)k] - covered * covered * (across + down), 0.0f);
                    }
                }
                rgba[4 * at + 3] = SBL__MAX(rgba[4 * at + 3], SBL__LEAST_NOISE);
            }
    }
    if (!left) return SBL_SUCCESS;
    orphans = (int *)sbl__alloc(base, (size_t)left, sizeof *orphans);
    found = (float *)sbl__alloc(base, (size_t)left, 4 * sizeof *found);
    if (!orphans || !found) { sbl__free(base, orphans); sbl__free(base, found); return SBL_ERROR_OUT_OF_MEMORY; }
    left = 0;
    for (at = 0; at < pixels; at++) if (r->pixels[at].id && rgba[4 * at + 3] == 0.0f) orphans[left++] = (int)at;
    do {
        before = left;
        for (i = 0; i < left; i++)
            if (!sbl__refine_spread(r, rgba, orphans[i] % r->width, orphans[i] / r->width, found + 4 * i)) found[4 * i + 3] = 0;
        for (i = left = 0; i < before; i++) {
            if (found[4 * i + 3] > 0) memcpy(rgba + 4 * (size_t)orphans[i], found + 4 * i, 4 * sizeof(float));
            else orphans[left++] = orphans[i];
        }
    } while (left && left < before);
    for (i = 0; i < left; i++) {
        for (k = 0; k < 3; k++) rgba[4 * (size_t)orphans[i] + (size_t)k] = r->pixels[orphans[i]].radiance[k];
        rgba[4 * (size_t)orphans[i] + 3] = SBL__LEAST_NOISE;
    }
    sbl__free(base, orphans);
    sbl__free(base, found);
    return SBL_SUCCESS;
}

static sbl_result sbl__refine_begin(sbl__base *base, sbl__refine *r) {
    int x, y;
    sbl_result result = SBL_SUCCESS;
    for (y = 0; y == 0 || y < r->height - 1; y += r->tile)
        for (x = 0; (x == 0 || x < r->width - 1) && result == SBL_SUCCESS; x += r->tile)
            result = sbl__refine_add_cell(base, r, x, y, SBL__MIN(x + r->tile, r->width - 1), SBL__MIN(y + r->tile, r->height - 1), 0);
    return result;
}

static void sbl__refine_free(sbl__base *base, sbl__refine *r) {
    sbl__free(base, r->pixels);
    sbl__free(base, r->cells);
    sbl__free(base, r->sites);
    sbl__free(base, r->site_pixels);
    sbl__free(base, r->readings);
    sbl__free(base, r->suspects);
    sbl__free(base, r->suspect_readings);
    memset(r, 0, sizeof *r);
}

/* ======================================================================================================== >>filter
   Smoothing of R (section III-H), see filter.glsl. Draws into the framebuffer bound by the caller. */

#define SBL__VISIBLE_DIFFERENCE 0.01f  /* relative; below it all is smoothed */
#define SBL__TEXEL_NOISE 2.6f          /* of a rasterised sensor, relative, times its size: measured for a lamp in a box */

static void sbl__filter_draw(const sbl__gl *gl, unsigned program, unsigned empty_array, const sbl__gbuffer *g, const sbl__texture *radiance, int radius, int geometry_aware, float tolerance) {
    double sigma = SBL__MAX(0.5 * radius, 0.1);
    gl->BindVertexArray(empty_array);
    gl->Disable(SBL__GL_DEPTH_TEST);
    gl->Viewport(0, 0, radiance->width, radiance->height);
    gl->UseProgram(program);
    sbl__bind(gl, program, "radiance", 0, SBL__GL_TEXTURE_2D, radiance->id);
    sbl__bind(gl, program, "positions", 1, SBL__GL_TEXTURE_2D, g->position.id);
    sbl__bind(gl, program, "normals", 2, SBL__GL_TEXTURE_2D, g->normal.id);
    sbl__bind(gl, program, "ids", 3, SBL__GL_TEXTURE_2D, g->id.id);
    sbl__uniform_i(gl, program, "radius", radius);
    sbl__uniform_f(gl, program, "falloff", (float)(1 / (2 * sigma * sigma)));
    sbl__uniform_i(gl, program, "geometry_aware", geometry_aware);
    sbl__uniform_f(gl, program, "tolerance", tolerance);
    gl->DrawArrays(SBL__GL_TRIANGLES, 0, 3);
}

/* ======================================================================================================== >>resolve
   Composition and anti-aliasing, see resolve.glsl. Draws into the framebuffer bound by the caller. */

/* Where sample i of count lies in the pixel, from its centre: the R2 sequence (Roberts 2018, "The Unreasonable Effectiveness of Quasirandom
   Sequences"); one sample is the centre. */
static void sbl__sample_offset(int i, int count, float out[2]) {
    double x = 0.5 + (i + 0.5) * 0.7548776662466927, y = 0.5 + (i + 0.5) * 0.5698402909980532;
    out[0] = count == 1 ? 0 : (float)(x - floor(x) - 0.5);
    out[1] = count == 1 ? 0 : (float)(y - floor(y) - 0.5);
}

static void sbl__resolve_draw(const sbl__gl *gl, unsigned program, unsigned empty_array, const sbl__gbuffer *g, const sbl__gbuffer *sample, const sbl__texture *radiance,
                              const sbl__texture *previous, const float offset[2], int index, int count, const sbl__scene *scene, const sbl__camera *camera) {
    static const char *const names[3] = { "direction_0", "direction_x", "direction_y" };
    double ray[6][3];
    int i;
    sbl__camera_rays(camera, offset, radiance->width, radiance->height, ray);
    gl->BindVertexArray(empty_array);
    gl->Disable(SBL__GL_DEPTH_TEST);
    gl->Viewport(0, 0, radiance->width, radiance->height);
    gl->UseProgram(program);
    sbl__bind(gl, program, "radiance", 0, SBL__GL_TEXTURE_2D, radiance->id);
    sbl__bind(gl, program, "positions", 1, SBL__GL_TEXTURE_2D, g->position.id);
    sbl__bind(gl, program, "normals", 2, SBL__GL_TEXTURE_2D, g->normal.id);
    sbl__bind(gl, program, "ids", 3, SBL__GL_TEXTURE_2D, g->id.id);
    sbl__bind(gl, program, "sample_positions", 4, SBL__GL_TEXTURE_2D, sample->position.id);
    sbl__bind(gl, program, "sample_normals", 5, SBL__GL_TEXTURE_2D, sample->normal.id);
    sbl__bind(gl, program, "sample_albedo", 6, SBL__GL_TEXTURE_2D, sample->albedo.id);
    sbl__bind(gl, program, "sample_emission", 7, SBL__GL_TEXTURE_2D, sample->emission.id);
    sbl__bind(gl, program, "sample_ids", 8, SBL__GL_TEXTURE_2D, sample->id.id);
    sbl__bind(gl, program, "previous", 9, SBL__GL_TEXTURE_2D, previous->id);
    gl->Uniform2f(sbl__uniform(gl, program, "offset"), offset[0], offset[1]);
    sbl__sky_bind(gl, scene, program, 10);
    for (i = 0; i < 3; i++) gl->Uniform3f(sbl__uniform(gl, program, names[i]), (float)ray[3 + i][0], (float)ray[3 + i][1], (float)ray[3 + i][2]);
    sbl__uniform_f(gl, program, "first", index ? 1.0f : 0.0f);
    sbl__uniform_f(gl, program, "share", 1.0f / (float)count);
    gl->DrawArrays(SBL__GL_TRIANGLES, 0, 3);
}

/* ======================================================================================================== >>picture
   The stages in steps. Every call of sbl__picture_work does one bounded piece. */

typedef enum sbl__stage { SBL__STAGE_NONE, SBL__STAGE_SURFACE, SBL__STAGE_COLLECT, SBL__STAGE_GATHER, SBL__STAGE_PROBE, SBL__STAGE_JUDGE, SBL__STAGE_FILL, SBL__STAGE_FILTER,
                          SBL__STAGE_RESOLVE, SBL__STAGE_DONE } sbl__stage;

typedef struct sbl__picture {
    sbl__stage stage;
    sbl_picture_desc desc;      /* defaults filled in */
    sbl__camera camera;
    sbl__gbuffer gbuffer, sample;
    sbl__refine refine;
    sbl__texture radiance, filtered, finals[2], scalars[2];  /* scalars: DEPTH and SENSORS for sbl_channel_texture */
    unsigned filter_framebuffer, final_framebuffers[2];
    int resolved;               /* anti-aliasing samples done */
    float progress;
} sbl__picture;

#define SBL__SCENE_PROGRAMS 10

struct sbl_context {
    sbl__base base;
    sbl__gl gl;
    sbl_context_desc desc;
    struct { unsigned gbuffer, sky, sensor[2], sensor_textured[2], trace[2], trace_textured[2], copy, reduce_blocks, reduce_sum, filter, resolve; } programs;  /* the first SBL__SCENE_PROGRAMS read the scene */
    int wide;                   /* these read wide scenes */
    unsigned empty_array;       /* a vertex array without attributes */
    sbl__gather gather, probe, inspected;  /* probe: sensors that look back at their surface, see sbl__refine_suspects; inspected: one sensor's views */
    sbl__scene scene;
    int has_scene;
    sbl__picture picture;
    sbl_stats stats;
#ifdef SBL_EGL
    EGLDisplay egl_display;
    EGLContext egl_context;
    EGLSurface egl_surface;
#endif
    int owns_egl;
};

static void sbl__picture_free(sbl_context *c) {
    sbl__picture *p = &c->picture;
    sbl__name_delete(c->gl.DeleteFramebuffers, &p->filter_framebuffer);
    sbl__name_delete(c->gl.DeleteFramebuffers, &p->final_framebuffers[0]);
    sbl__name_delete(c->gl.DeleteFramebuffers, &p->final_framebuffers[1]);
    sbl__texture_delete(&c->gl, &p->radiance);
    sbl__texture_delete(&c->gl, &p->filtered);
    sbl__texture_delete(&c->gl, &p->finals[0]);
    sbl__texture_delete(&c->gl, &p->finals[1]);
    sbl__texture_delete(&c->gl, &p->scalars[0]);
    sbl__texture_delete(&c->gl, &p->scalars[1]);
    sbl__gbuffer_free(&c->gl, &p->gbuffer);
    sbl__gbuffer_free(&c->gl, &p->sample);
    sbl__refine_free(&c->base, &p->refine);
    sbl__gather_free(&c->gl, &c->gather);
    sbl__gather_free(&c->gl, &c->probe);
    sbl__gather_free(&c->gl, &c->inspected);
    memset(p, 0, sizeof *p);
}

static int sbl__picture_hemicube(const sbl_picture_desc *d) { return d->sensor_kind == SBL_SENSOR_HEMICUBE; }

/* Sets up sensors that rasterise, as the picture wants them. */
static sbl_result sbl__picture_raster(sbl_context *c, sbl__gather *g, int lamps_apart) {
    const sbl_picture_desc *d = &c->picture.desc;
    const int paper = d->mode == SBL_MODE_PAPER;
    g->lamps_apart = lamps_apart && !paper;
    g->environment = !paper;
    return sbl__gather_setup(&c->gl, g, &c->scene, sbl__picture_hemicube(d), paper, d->sensor_size, d->sensor_fov, d->epsilon,
                             g->lamps_apart && c->scene.lamp_leaves ? d->rays : 0, c->desc.atlas_size, c->desc.batch);
}

static sbl_result sbl__picture_begin(sbl_context *c) {
    sbl__picture *p = &c->picture;
    const sbl_picture_desc *d = &p->desc;
    const char *what = "making the picture's textures";
    const sbl__gl *gl = &c->gl;
    const sbl__texture *colors[1];
    int i;
    sbl_result result;
    sbl__camera_make(&p->camera, d, &c->scene);
    p->camera.facet_limit = d->facet_limit;
    p->refine.width = d->width;
    p->refine.height = d->height;
    p->refine.tile = d->tile;
    p->refine.threshold = d->threshold;
    p->refine.geometry_aware = p->refine.relative = d->mode != SBL_MODE_PAPER;
    p->refine.seed = d->seed;
    p->refine.pixels = (sbl__pixel *)sbl__alloc(&c->base, (size_t)d->width * (size_t)d->height, sizeof(sbl__pixel));
    if (!p->refine.pixels) return SBL_ERROR_OUT_OF_MEMORY;
    result = sbl__gbuffer_make(gl, &p->gbuffer, d->width, d->height);
    if (result == SBL_SUCCESS && d->samples > 1) result = sbl__gbuffer_make(gl, &p->sample, d->width, d->height);
    if (result == SBL_SUCCESS) result = sbl__texture_make(gl, &p->filtered, d->width, d->height, SBL__GL_RGBA32F, NULL, what);
    colors[0] = &p->filtered;
    if (result == SBL_SUCCESS) result = sbl__framebuffer_make(gl, &p->filter_framebuffer, colors, 1, NULL, what);
    for (i = 0; i < 2 && result == SBL_SUCCESS; i++) {
        result = sbl__texture_make(gl, &p->finals[i], d->width, d->height, SBL__GL_RGBA32F, NULL, what);
        colors[0] = &p->finals[i];
        if (result == SBL_SUCCESS) result = sbl__framebuffer_make(gl, &p->final_framebuffers[i], colors, 1, NULL, what);
    }
    if (result == SBL_SUCCESS) result = sbl__refine_begin(&c->base, &p->refine);
    p->stage = SBL__STAGE_SURFACE;
    return result;
}

/* Sets up sensors that trace rays. Where only lamps shine, rays over the hemisphere merely tell where a sensor stands: few do. */
static sbl_result sbl__picture_trace(sbl_context *c) {
    const sbl_picture_desc *d = &c->picture.desc;
    const sbl__scene *s = &c->scene;
    int dark = !s->sky_pixels && !(d->epsilon + s->sky[0] + s->sky[1] + s->sky[2] > 0);
    return sbl__trace_setup(&c->gl, &c->gather, &s->bvh, dark ? SBL__MIN(d->rays, SBL__CHUNK) : d->rays, s->lamp_leaves ? d->rays : 0, 1, d->epsilon, c->desc.batch);
}

/* Draws the G-buffer and brings to the host what refinement decides by. */
static sbl_result sbl__picture_surface(sbl_context *c) {
    static const float centre[2] = { 0, 0 };
    sbl__picture *p = &c->picture;
    size_t pixels = (size_t)p->desc.width * (size_t)p->desc.height, i;
    const sbl__texture *textures[4];
    int attachments[4] = { 0, 1, 2, 5 }, traced = p->desc.backend == SBL_BACKEND_TRACE, t, k;
    float *data;
    sbl_result result = p->desc.mode == SBL_MODE_PAPER ? SBL_SUCCESS : sbl__bvh_ready(&c->gl, &c->scene);
    if (result == SBL_SUCCESS) result = traced ? sbl__picture_trace(c) : sbl__picture_raster(c, &c->gather, 1);
    if (result != SBL_SUCCESS) return result;
    c->stats.bvh_seconds = c->scene.bvh.seconds;
    c->stats.lamps = p->desc.mode == SBL_MODE_PAPER ? 0 : c->scene.lamp_leaves;
    c->stats.bvh_bytes = c->scene.node_buffer.bytes + c->scene.triangle_buffer.bytes + c->scene.node_texels.bytes + c->scene.triangle_texels.bytes;
    sbl__surface_draw(&c->gl, c->programs.gbuffer, &c->scene, &p->camera, &p->gbuffer, centre, p->desc.epsilon);
    result = sbl__gl_check(&c->gl, "drawing the G-buffer");
    if (result != SBL_SUCCESS) return result;
    data = (float *)sbl__alloc(&c->base, pixels, 16);
    if (!data) return SBL_ERROR_OUT_OF_MEMORY;
    textures[0] = &p->gbuffer.position; textures[1] = &p->gbuffer.normal; textures[2] = &p->gbuffer.geometric_normal; textures[3] = &p->gbuffer.id;
    for (t = 0; t < 4 && result == SBL_SUCCESS; t++) {
        result = sbl__read_pixels(&c->gl, p->gbuffer.framebuffer, attachments[t], textures[t], p->desc.height, data, "reading the G-buffer");
        c->stats.readbacks++;
        for (i = 0; i < pixels && result == SBL_SUCCESS; i++) {
            sbl__pixel *pixel = &p->refine.pixels[i];
            float *to = t == 0 ? pixel->position : t == 1 ? pixel->normal : pixel->geometric_normal;
            if (t == 3) { memcpy(&pixel->id, data + i, 4); c->stats.visible_pixels += pixel->id != 0; }
            else for (k = 0; k < 3; k++) to[k] = data[4 * i + (size_t)k];
            if (t == 0) pixel->offset = SBL__OFFSET * (traced && data[4 * i + 3] > 0 ? data[4 * i + 3] : c->scene.extent);
        }
    }
    sbl__free(&c->base, data);
    if (result == SBL_SUCCESS && c->stats.visible_pixels == 0)
        sbl__log(&c->base, SBL_LOG_WARNING, SBL_LOG_ITEM_NOTHING_VISIBLE, "the camera sees no surface; check world_to_view, view_to_clip and the scene's bounds");
    return result;
}

static sbl_result sbl__picture_fill(sbl_context *c) {
    sbl__picture *p = &c->picture;
    size_t pixels = (size_t)p->desc.width * (size_t)p->desc.height;
    float *rgba = (float *)sbl__alloc(&c->base, pixels, 16);
    sbl_result result;
    if (!rgba) return SBL_ERROR_OUT_OF_MEMORY;
    result = sbl__refine_fill(&c->base, &p->refine, rgba);
    if (result == SBL_SUCCESS) result = sbl__texture_make(&c->gl, &p->radiance, p->desc.width, p->desc.height, SBL__GL_RGBA32F, rgba, "sending the radiance map");
    sbl__free(&c->base, rgba);
    return result;
}

static sbl_result sbl__probe_begin(sbl_context *c, const sbl__site *sites, int count) {
    sbl_result result = SBL_SUCCESS;
    if (!c->probe.slots && c->gather.rays) result = sbl__trace_setup(&c->gl, &c->probe, &c->scene.bvh, 1, 0, 0, 0, c->desc.batch);
    else if (!c->probe.slots) result = sbl__gather_setup(&c->gl, &c->probe, &c->scene, 0, 0, SBL__PROBE_SIZE, SBL__PROBE_FOV, 0, 0, SBL__MIN(c->desc.atlas_size, 512), c->desc.batch);
    return result == SBL_SUCCESS ? sbl__gather_begin(&c->gl, &c->probe, sites, count) : result;
}

/* One piece of the work; limit: sensors at most. */
static sbl_result sbl__picture_work(sbl_context *c, int limit) {
    sbl__picture *p = &c->picture;
    const sbl__gl *gl = &c->gl;
    const unsigned reduce[2] = { c->programs.reduce_blocks, c->programs.reduce_sum };
    const unsigned *views = c->scene.textured ? c->programs.sensor_textured : c->programs.sensor, *trace = c->scene.textured ? c->programs.trace_textured : c->programs.trace;
    const unsigned draw[3] = { views[0], c->programs.sky, c->scene.draw ? views[1] : trace[1] };  /* what the host draws, only views show */
    double start = sbl__now(), *seconds = NULL;
    sbl_result result = SBL_SUCCESS;
    switch (p->stage) {
        case SBL__STAGE_SURFACE:
            seconds = &c->stats.seconds.surface;
            result = sbl__picture_surface(c);
            p->stage = SBL__STAGE_COLLECT;
            break;
        case SBL__STAGE_COLLECT:
            seconds = &c->stats.seconds.refine;
            result = sbl__refine_collect(&c->base, &p->refine);
            if (result == SBL_SUCCESS && p->refine.site_count) result = sbl__gather_begin(gl, &c->gather, p->refine.sites, p->refine.site_count);
            p->stage = p->refine.site_count ? SBL__STAGE_GATHER : SBL__STAGE_JUDGE;
            break;
        case SBL__STAGE_GATHER:
            seconds = &c->stats.seconds.gather;
            result = sbl__gather_step(gl, &c->gather, &c->scene, c->gather.rays ? trace : draw, reduce, c->empty_array, limit);
            if (result == SBL_SUCCESS && c->gather.next == c->gather.count) {
                result = sbl__gather_finish(gl, &c->gather, p->refine.readings);
                c->stats.readbacks += 2;
                c->stats.rays += (int64_t)c->gather.count * c->gather.rays;
                if (!c->gather.rays) c->stats.sensor_views += (int64_t)c->gather.count * c->gather.layout.view_count;
                if (!c->gather.rays)
                c->stats.sensor_texels += (int64_t)c->gather.count * (sbl__picture_hemicube(&p->desc) ? c->gather.layout.sheet_width * c->gather.layout.sheet_height
                                                                                                     : p->desc.sensor_size * p->desc.sensor_size);
                if (result == SBL_SUCCESS) result = sbl__refine_suspects(&c->base, &p->refine);
                p->stage = p->refine.suspect_count ? SBL__STAGE_PROBE : SBL__STAGE_JUDGE;
                if (result == SBL_SUCCESS && p->refine.suspect_count) result = sbl__probe_begin(c, p->refine.suspects, p->refine.suspect_count);
            }
            break;
        case SBL__STAGE_PROBE:
            seconds = &c->stats.seconds.gather;
            result = sbl__gather_step(gl, &c->probe, &c->scene, c->probe.rays ? trace : draw, reduce, c->empty_array, limit);
            if (result == SBL_SUCCESS && c->probe.next == c->probe.count) {
                result = sbl__gather_finish(gl, &c->probe, p->refine.suspect_readings);
                c->stats.readbacks += 2;
                if (result == SBL_SUCCESS) sbl__refine_convict(&c->base, &p->refine);
                p->stage = SBL__STAGE_JUDGE;
            }
            break;
        case SBL__STAGE_JUDGE:
            seconds = &c->stats.seconds.refine;
            result = sbl__refine_judge(&c->base, &p->refine, &c->stats);
            p->stage = p->refine.fresh < p->refine.cell_count ? SBL__STAGE_COLLECT : SBL__STAGE_FILL;
            break;
        case SBL__STAGE_FILL:
            seconds = &c->stats.seconds.refine;
            result = sbl__picture_fill(c);
            p->stage = SBL__STAGE_FILTER;
            break;
        case SBL__STAGE_FILTER:
            seconds = &c->stats.seconds.filter;
            gl->BindFramebuffer(SBL__GL_DRAW_FRAMEBUFFER, p->filter_framebuffer);
            sbl__filter_draw(gl, c->programs.filter, c->empty_array, &p->gbuffer, &p->radiance, SBL__MAX(p->desc.filter_radius, 0), p->desc.mode != SBL_MODE_PAPER,
                             p->desc.backend == SBL_BACKEND_TRACE ? SBL__VISIBLE_DIFFERENCE : SBL__TEXEL_NOISE / (float)p->desc.sensor_size);
            gl->Finish();
            result = sbl__gl_check(gl, "filtering");
            p->stage = SBL__STAGE_RESOLVE;
            break;
        case SBL__STAGE_RESOLVE: {
            int from = p->resolved & 1, samples = p->desc.samples;
            const sbl__gbuffer *sample = samples > 1 ? &p->sample : &p->gbuffer;
            float offset[2];
            seconds = &c->stats.seconds.resolve;
            sbl__sample_offset(p->resolved, samples, offset);
            if (samples > 1) sbl__surface_draw(gl, c->programs.gbuffer, &c->scene, &p->camera, &p->sample, offset, p->desc.epsilon);
            gl->BindFramebuffer(SBL__GL_DRAW_FRAMEBUFFER, p->final_framebuffers[1 - from]);
            sbl__resolve_draw(gl, c->programs.resolve, c->empty_array, &p->gbuffer, sample, &p->filtered, &p->finals[from], offset, p->resolved, samples, &c->scene, &p->camera);
            gl->Finish();
            result = sbl__gl_check(gl, "composing the picture");
            p->resolved++;
            if (p->resolved == samples) p->stage = SBL__STAGE_DONE;
            break;
        }
        default: break;
    }
    if (seconds) *seconds += sbl__now() - start;
    return result;
}

/* An estimate: half of the bar for the first rounds' sensors, as a share of what the present job will take. */
static float sbl__picture_progress(const sbl_context *c) {
    const sbl__picture *p = &c->picture;
    float round;
    switch (p->stage) {
        case SBL__STAGE_NONE: return 0;
        case SBL__STAGE_SURFACE: return 0;
        case SBL__STAGE_COLLECT: case SBL__STAGE_GATHER: case SBL__STAGE_PROBE: case SBL__STAGE_JUDGE:
            /* round k of about log2(tile) + 1 costs about twice the one before */
            round = (float)p->refine.rounds + (p->stage == SBL__STAGE_GATHER && c->gather.count ? (float)c->gather.next / (float)c->gather.count : 0.0f);
            { float rounds = 1 + (float)(log((double)p->desc.tile) / log(2.0)); float share = (float)((pow(2, SBL__MIN(round / rounds, 1.0f) * rounds) - 1) / (pow(2, rounds) - 1));
              return 0.02f + 0.9f * SBL__MIN(share, 1.0f); }
        case SBL__STAGE_FILL: return 0.93f;
        case SBL__STAGE_FILTER: return 0.94f;
        case SBL__STAGE_RESOLVE: return 0.95f + 0.05f * (float)p->resolved / (float)p->desc.samples;
        default: return 1;
    }
}

/* ======================================================================================================== >>public
   Thin: validate, run the stages, put GL back. */

#ifdef SBL_EGL
static sbl_gl_function sbl__egl_proc(const char *name, void *user) { (void)user; return (sbl_gl_function)eglGetProcAddress(name); }

static int sbl__egl_try(sbl_context *c, EGLDisplay display, int pbuffer) {
    static const EGLint context_attributes[] = { EGL_CONTEXT_MAJOR_VERSION, 3, EGL_CONTEXT_MINOR_VERSION, 3, EGL_CONTEXT_OPENGL_PROFILE_MASK, EGL_CONTEXT_OPENGL_CORE_PROFILE_BIT, EGL_NONE };
    static const EGLint surface_attributes[] = { EGL_WIDTH, 16, EGL_HEIGHT, 16, EGL_NONE };
    EGLint config_attributes[] = { EGL_SURFACE_TYPE, 0, EGL_RENDERABLE_TYPE, EGL_OPENGL_BIT, EGL_NONE };
    EGLConfig config = NULL;
    EGLint count = 0;
    if (display == EGL_NO_DISPLAY || !eglInitialize(display, NULL, NULL) || !eglBindAPI(EGL_OPENGL_API)) return 0;
    config_attributes[1] = pbuffer ? EGL_PBUFFER_BIT : 0;
    if (!eglChooseConfig(display, config_attributes, &config, 1, &count) || count < 1) return 0;
    c->egl_context = eglCreateContext(display, config, EGL_NO_CONTEXT, context_attributes);
    if (c->egl_context == EGL_NO_CONTEXT) return 0;
    c->egl_surface = pbuffer ? eglCreatePbufferSurface(display, config, surface_attributes) : EGL_NO_SURFACE;
    if ((pbuffer && c->egl_surface == EGL_NO_SURFACE) || !eglMakeCurrent(display, c->egl_surface, c->egl_surface, c->egl_context)) {
        if (c->egl_surface != EGL_NO_SURFACE) eglDestroySurface(display, c->egl_surface);
        eglDestroyContext(display, c->egl_context);
        c->egl_context = EGL_NO_CONTEXT;
        return 0;
    }
    c->egl_display = display;
    return 1;
}

/* Surfaceless, then each device, then a pbuffer on the default display. Displays are shared process-wide and stay initialised. */
static sbl_result sbl__egl_create(sbl_context *c) {
    PFNEGLGETPLATFORMDISPLAYEXTPROC get_display = (PFNEGLGETPLATFORMDISPLAYEXTPROC)eglGetProcAddress("eglGetPlatformDisplayEXT");
    PFNEGLQUERYDEVICESEXTPROC query_devices = (PFNEGLQUERYDEVICESEXTPROC)eglGetProcAddress("eglQueryDevicesEXT");
    const char *extensions = eglQueryString(EGL_NO_DISPLAY, EGL_EXTENSIONS);
    EGLDeviceEXT devices[16];
    EGLint count = 0, i;
    int made = 0;
    if (get_display && extensions && strstr(extensions, "EGL_MESA_platform_surfaceless")) made = sbl__egl_try(c, get_display(EGL_PLATFORM_SURFACELESS_MESA, EGL_DEFAULT_DISPLAY, NULL), 0);
    if (!made && get_display && query_devices && extensions && strstr(extensions, "EGL_EXT_platform_device") && query_devices(16, devices, &count))
        for (i = 0; i < count && !made; i++) made = sbl__egl_try(c, get_display(EGL_PLATFORM_DEVICE_EXT, devices[i], NULL), 0);
    if (!made) made = sbl__egl_try(c, eglGetDisplay(EGL_DEFAULT_DISPLAY), 1);
    if (!made) {
        sbl__log(&c->base, SBL_LOG_ERROR, SBL_LOG_ITEM_NO_GL, "no headless OpenGL 3.3 context could be made (tried surfaceless, devices, pbuffer; EGL error 0x%04x); "
                 "install a GL driver such as Mesa's, or hand over get_gl_function", (unsigned)eglGetError());
        return SBL_ERROR_UNSUPPORTED;
    }
    c->owns_egl = 1;
    return SBL_SUCCESS;
}
#endif

/* What every function that uses GL does first and last: own context made current, state saved and forced; and the way back. */
typedef struct sbl__visit {
    sbl__guard guard;
#ifdef SBL_EGL
    EGLDisplay display;
    EGLContext context;
    EGLSurface draw, read;
    EGLenum api;
    int switched;
#endif
} sbl__visit;

#ifdef SBL_EGL
static void sbl__egl_save(sbl__visit *v) {
    v->api = eglQueryAPI();
    v->display = eglGetCurrentDisplay();
    v->context = eglGetCurrentContext();
    v->draw = eglGetCurrentSurface(EGL_DRAW);
    v->read = eglGetCurrentSurface(EGL_READ);
    v->switched = 1;
}

static void sbl__egl_restore(const sbl_context *c, const sbl__visit *v) {
    if (!v->switched) return;
    if (c->egl_display != EGL_NO_DISPLAY) eglMakeCurrent(c->egl_display, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT);
    eglBindAPI(v->api);
    if (v->context != EGL_NO_CONTEXT) eglMakeCurrent(v->display, v->draw, v->read, v->context);
}
#endif

static void sbl__visit_enter(sbl_context *c, sbl__visit *v) {
#ifdef SBL_EGL
    v->switched = 0;
    if (c->owns_egl && eglGetCurrentContext() != c->egl_context) {
        sbl__egl_save(v);
        eglBindAPI(EGL_OPENGL_API);
        eglMakeCurrent(c->egl_display, c->egl_surface, c->egl_surface, c->egl_context);
    }
#endif
    sbl__guard_save(&c->gl, &v->guard);
    sbl__guard_force(&c->gl);
}

static void sbl__visit_leave(sbl_context *c, const sbl__visit *v) {
    sbl__guard_restore(&c->gl, &v->guard);
    sbl__gl_clear_errors(&c->gl);
#ifdef SBL_EGL
    sbl__egl_restore(c, v);
#endif
}

/* The programs that read the scene, anew: one that buffer textures hold, or a wide one. On failure the old ones stay. */
static sbl_result sbl__scene_programs_make(sbl_context *c, int wide) {
    static const char *const *const fullscreen[] = { sbl__glsl_fullscreen_vertex, NULL };
    static const char *const *const gbuffer_vertex[] = { sbl__glsl_scene, sbl__glsl_gbuffer_vertex, NULL };
    static const char *const *const gbuffer_fragment[] = { sbl__glsl_scene, sbl__glsl_surface, sbl__glsl_gbuffer_fragment, NULL };
    static const char *const *const sensor_vertex[] = { sbl__glsl_scene, sbl__glsl_sensor_vertex, NULL };
    static const char *const *const sensor_fragment[] = { sbl__glsl_scene, sbl__glsl_sensor_fragment, NULL };
    static const char *const *const sky_vertex[] = { sbl__glsl_sky_vertex, NULL };
    static const char *const *const sky_fragment[] = { sbl__glsl_sky, sbl__glsl_sky_fragment, NULL };
    static const char *const *const trace[] = { sbl__glsl_scene, sbl__glsl_surface, sbl__glsl_traverse, sbl__glsl_sky, sbl__glsl_trace, NULL };
    static const char *const *const lamps[] = { sbl__glsl_scene, sbl__glsl_surface, sbl__glsl_traverse, sbl__glsl_sky, sbl__glsl_lamps, NULL };
    static const struct { const char *name; const char *const *const *vertex, *const *const *fragment; int traces, textured, views; } list[SBL__SCENE_PROGRAMS] = {
        { "gbuffer", gbuffer_vertex, gbuffer_fragment, 0, 0, 0 },
        { "sky", sky_vertex, sky_fragment, 0, 0, 0 },
        { "sensor", sensor_vertex, sensor_fragment, 0, 0, 0 },
        { "lamps in views", fullscreen, lamps, 1, 0, 1 },
        { "sensor, textured", sensor_vertex, sensor_fragment, 0, 1, 0 },
        { "lamps in views, textured", fullscreen, lamps, 1, 1, 1 },
        { "trace", fullscreen, trace, 1, 0, 0 },
        { "lamps", fullscreen, lamps, 1, 0, 0 },
        { "trace, textured", fullscreen, trace, 1, 1, 0 },
        { "lamps, textured", fullscreen, lamps, 1, 1, 0 }
    };
    const sbl__gl *gl = &c->gl;
    const int clip = (gl->capabilities.used & SBL_CAPABILITY_CLIP_CONTROL) != 0, compute = (gl->capabilities.used & SBL_CAPABILITY_COMPUTE) != 0;
    unsigned made[SBL__SCENE_PROGRAMS] = { 0 }, *programs = &c->programs.gbuffer;
    sbl_result result = SBL_SUCCESS;
    int i;
    for (i = 0; i < SBL__SCENE_PROGRAMS && result == SBL_SUCCESS; i++) {
        char defines[200];
        snprintf(defines, sizeof defines, "#define SBL_STACK %d\n#define SBL_LAMPS %d\n%s%s%s%s", SBL__BVH_STACK, SBL__MAX_LAMPS, list[i].views ? "#define SBL_VIEWS\n" : "", clip ? "" : "#define SBL_WRITE_DEPTH\n",
                 wide ? "#define SBL_WIDE\n" : "", list[i].textured ? "#define SBL_TEXTURED\n" : "");
        result = sbl__program_make(gl, &made[i], list[i].name, defines, list[i].traces && compute ? NULL : list[i].vertex, list[i].fragment);
    }
    for (i = 0; i < SBL__SCENE_PROGRAMS; i++) {
        unsigned old = result == SBL_SUCCESS ? programs[i] : made[i];
        if (old) gl->DeleteProgram(old);
        if (result == SBL_SUCCESS) programs[i] = made[i];
    }
    if (result == SBL_SUCCESS) c->wide = wide;
    return result;
}

static sbl_result sbl__programs_make(sbl_context *c) {
    const sbl__gl *gl = &c->gl;
    static const char *const *const fullscreen[] = { sbl__glsl_fullscreen_vertex, NULL };
    static const char *const *const copy[] = { sbl__glsl_copy, NULL };
    static const char *const *const reduce_blocks[] = { sbl__glsl_reduce_blocks, NULL };
    static const char *const *const reduce_sum[] = { sbl__glsl_reduce_sum, NULL };
    static const char *const *const filter[] = { sbl__glsl_belongs, sbl__glsl_filter, NULL };
    static const char *const *const resolve[] = { sbl__glsl_belongs, sbl__glsl_sky, sbl__glsl_resolve, NULL };
    sbl_result result = sbl__program_make(gl, &c->programs.copy, "copy", "", fullscreen, copy);
    if (result == SBL_SUCCESS) result = sbl__scene_programs_make(c, 0);
    if (result == SBL_SUCCESS) result = sbl__program_make(gl, &c->programs.reduce_blocks, "reduce_blocks", "", fullscreen, reduce_blocks);
    if (result == SBL_SUCCESS) result = sbl__program_make(gl, &c->programs.reduce_sum, "reduce_sum", "", fullscreen, reduce_sum);
    if (result == SBL_SUCCESS) result = sbl__program_make(gl, &c->programs.filter, "filter", "", fullscreen, filter);
    if (result == SBL_SUCCESS) result = sbl__program_make(gl, &c->programs.resolve, "resolve", "", fullscreen, resolve);
    if (result == SBL_SUCCESS) {
        c->empty_array = sbl__name_make(gl, gl->GenVertexArrays, "making a vertex array");
        result = c->empty_array ? sbl__gl_check(gl, "making a vertex array") : SBL_ERROR_GL;
    }
    return result;
}

static sbl_result sbl__check_context_desc(const sbl__base *base, const sbl_context_desc *d) {
    sbl__check check;
    check.base = base;
    check.mistakes = 0;
    if (!SBL__CANARY_OK(d)) {
        SBL__MISTAKE(&check, SBL_LOG_ITEM_INVALID_CONTEXT_DESC, "sbl_context_desc: start_canary is 0x%x, end_canary 0x%x; zero the whole struct before use", d->start_canary, d->end_canary);
        return SBL_ERROR_INVALID_ARGUMENT;
    }
    if (!d->allocator.alloc != !d->allocator.free)
        SBL__MISTAKE(&check, SBL_LOG_ITEM_INVALID_CONTEXT_DESC, "sbl_context_desc: allocator.%s is NULL; give both functions or none", d->allocator.alloc ? "free" : "alloc");
    if (d->disabled & ~(uint32_t)SBL_CAPABILITY_ALL)
        SBL__MISTAKE(&check, SBL_LOG_ITEM_INVALID_CONTEXT_DESC, "sbl_context_desc: disabled is 0x%x; only the bits 0x%x exist", d->disabled, (unsigned)SBL_CAPABILITY_ALL);
    if (d->atlas_size != 0 && (d->atlas_size < 256 || d->atlas_size > 16384))
        SBL__MISTAKE(&check, SBL_LOG_ITEM_INVALID_CONTEXT_DESC, "sbl_context_desc: atlas_size is %d; it must be 256 to 16384, or 0 for the default", d->atlas_size);
    if (d->batch < 0)
        SBL__MISTAKE(&check, SBL_LOG_ITEM_INVALID_CONTEXT_DESC, "sbl_context_desc: batch is %d; it cannot be negative", d->batch);
    return check.mistakes ? SBL_ERROR_INVALID_ARGUMENT : SBL_SUCCESS;
}

SBL_API sbl_context_desc sbl_context_desc_defaults(const sbl_context_desc *desc) {
    sbl_context_desc d;
    memset(&d, 0, sizeof d);
    if (desc) d = *desc;
    if (!d.allocator.alloc && !d.allocator.free) {
        d.allocator.alloc = sbl__default_alloc;
        d.allocator.free = sbl__default_free;
    }
    if (!d.logger.log) d.logger.log = sbl__default_log;
    if (!d.atlas_size) d.atlas_size = 2048;
    return d;
}

SBL_API sbl_picture_desc sbl_picture_desc_defaults(const sbl_picture_desc *desc) {
    sbl_picture_desc d;
    int draft, high, paper;
    memset(&d, 0, sizeof d);
    if (desc) d = *desc;
    draft = d.preset == SBL_PRESET_DRAFT;
    high = d.preset == SBL_PRESET_HIGH;
    if (d.mode == SBL_MODE_DEFAULT) d.mode = SBL_MODE_AMBIENT;
    paper = d.mode == SBL_MODE_PAPER;
    if (!d.width && !d.height) { d.width = 640; d.height = 480; }
    if (d.width > 0 && d.height > 0 && sbl__all_zero(d.view_to_clip, 16)) sbl_perspective(d.view_to_clip, 40, (float)d.width / (float)d.height);
    if (d.sensor_kind == SBL_SENSOR_DEFAULT) d.sensor_kind = paper ? SBL_SENSOR_SINGLE : SBL_SENSOR_HEMICUBE;
    if (!d.sensor_size) d.sensor_size = draft ? 32 : high ? 128 : 64;
    if (d.sensor_fov == 0.0f) d.sensor_fov = 135;
    if (!d.rays) d.rays = draft ? 64 : high ? 1024 : 256;
    if (!d.tile) d.tile = high ? 8 : 16;
    if (d.threshold == 0.0f) d.threshold = paper ? 0.05f : draft ? 0.3f : high ? 0.07f : 0.15f;
    if (d.mode == SBL_MODE_DIRECT) d.epsilon = 0;
    else if (d.epsilon == 0.0f) d.epsilon = 0.02f;
    if (!d.filter_radius) d.filter_radius = 2;
    if (!d.samples) d.samples = draft ? 1 : high ? 16 : 4;
    return d;
}

/* d has its defaults filled in; `given` is what the host wrote. */
static sbl_result sbl__check_picture_desc(const sbl_context *c, const sbl_picture_desc *given, const sbl_picture_desc *d) {
    const sbl_log_item item = SBL_LOG_ITEM_INVALID_PICTURE_DESC;
    const float *m = d->view_to_clip;
    sbl__check check;
    int i, k;
    check.base = &c->base;
    check.mistakes = 0;
    if (given && !SBL__CANARY_OK(given)) {
        SBL__MISTAKE(&check, item, "sbl_picture_desc: start_canary is 0x%x, end_canary 0x%x; zero the whole struct before use", given->start_canary, given->end_canary);
        return SBL_ERROR_INVALID_ARGUMENT;
    }
    if (d->width < 1 || d->width > 16384) SBL__MISTAKE(&check, item, "sbl_picture_desc: width is %d; it must be 1 to 16384", d->width);
    if (d->height < 1 || d->height > 16384) SBL__MISTAKE(&check, item, "sbl_picture_desc: height is %d; it must be 1 to 16384", d->height);
    if ((int)d->mode < 0 || d->mode >= SBL_MODE_COUNT) SBL__MISTAKE(&check, item, "sbl_picture_desc: mode is %d; it must be 0 to %d", (int)d->mode, SBL_MODE_COUNT - 1);
    if ((int)d->preset < 0 || d->preset >= SBL_PRESET_COUNT) SBL__MISTAKE(&check, item, "sbl_picture_desc: preset is %d; it must be 0 to %d", (int)d->preset, SBL_PRESET_COUNT - 1);
    if ((int)d->sensor_kind < 0 || d->sensor_kind >= SBL_SENSOR_KIND_COUNT)
        SBL__MISTAKE(&check, item, "sbl_picture_desc: sensor_kind is %d; it must be 0 to %d", (int)d->sensor_kind, SBL_SENSOR_KIND_COUNT - 1);
    if (d->mode == SBL_MODE_PAPER && d->sensor_kind == SBL_SENSOR_HEMICUBE)
        SBL__MISTAKE(&check, item, "sbl_picture_desc: sensor_kind is SBL_SENSOR_HEMICUBE in SBL_MODE_PAPER; the paper's sensor is SBL_SENSOR_SINGLE");
    if ((int)d->backend < 0 || d->backend >= SBL_BACKEND_COUNT) SBL__MISTAKE(&check, item, "sbl_picture_desc: backend is %d; it must be 0 to %d", (int)d->backend, SBL_BACKEND_COUNT - 1);
    if (d->backend == SBL_BACKEND_TRACE && (d->mode == SBL_MODE_PAPER || d->sensor_kind == SBL_SENSOR_SINGLE || c->scene.draw))
        SBL__MISTAKE(&check, item, "sbl_picture_desc: backend is SBL_BACKEND_TRACE %s; use SBL_BACKEND_AUTO or SBL_BACKEND_RASTER",
                     c->scene.draw ? "in a scene with a draw callback" : "with the paper's single view");
    if (d->rays < 1 || d->rays > 4096) SBL__MISTAKE(&check, item, "sbl_picture_desc: rays is %d; it must be 1 to 4096", d->rays);
    if (d->sensor_size < 4 || d->sensor_size > 512) SBL__MISTAKE(&check, item, "sbl_picture_desc: sensor_size is %d; it must be 4 to 512", d->sensor_size);
    if (!(d->sensor_fov >= 1.0f && d->sensor_fov <= 179.0f)) SBL__MISTAKE(&check, item, "sbl_picture_desc: sensor_fov is %g; it must be 1 to 179 degrees", (double)d->sensor_fov);
    if (d->tile < 1 || d->tile > 1024) SBL__MISTAKE(&check, item, "sbl_picture_desc: tile is %d; it must be 1 to 1024", d->tile);
    if (!(d->threshold > 0.0f && sbl__finite(d->threshold))) SBL__MISTAKE(&check, item, "sbl_picture_desc: threshold is %g; it must be positive and finite", (double)d->threshold);
    if (!(d->epsilon >= 0.0f && sbl__finite(d->epsilon))) SBL__MISTAKE(&check, item, "sbl_picture_desc: epsilon is %g; it must be finite and not negative", (double)d->epsilon);
    if (!(d->facet_limit >= 0.0f && sbl__finite(d->facet_limit))) SBL__MISTAKE(&check, item, "sbl_picture_desc: facet_limit is %g; it must be 0 or more, and finite", (double)d->facet_limit);
    if (d->filter_radius > 32) SBL__MISTAKE(&check, item, "sbl_picture_desc: filter_radius is %d; it must be at most 32", d->filter_radius);
    if (d->samples < 1 || d->samples > 64) SBL__MISTAKE(&check, item, "sbl_picture_desc: samples is %d; it must be 1 to 64", d->samples);
    if (!sbl__all_finite(d->world_to_view, 16)) {
        for (i = 0; i < 16; i++)
            if (!sbl__finite(d->world_to_view[i])) SBL__MISTAKE(&check, item, "sbl_picture_desc: world_to_view[%d] is %g; it must be finite", i, (double)d->world_to_view[i]);
    } else {
        const float *v = d->world_to_view;
        int rigid = v[3] == 0.0f && v[7] == 0.0f && v[11] == 0.0f && v[15] == 1.0f;
        for (i = 0; i < 3; i++)
            for (k = 0; k < 3; k++)
                if (fabs((double)v[i] * v[k] + (double)v[4 + i] * v[4 + k] + (double)v[8 + i] * v[8 + k] - (i == k)) > 1e-3) rigid = 0;
        if (sbl__affine_determinant(v) < 0) rigid = 0;
        if (!rigid) SBL__MISTAKE(&check, item, "sbl_picture_desc: world_to_view is not rigid (a rotation and a translation, column-major); sbl_look_at makes one");
    }
    if (!sbl__all_finite(m, 16)) {
        for (i = 0; i < 16; i++)
            if (!sbl__finite(m[i])) SBL__MISTAKE(&check, item, "sbl_picture_desc: view_to_clip[%d] is %g; it must be finite", i, (double)m[i]);
    } else if (check.mistakes == 0 || (d->width > 0 && d->height > 0)) {
        int perspective = m[3] == 0.0f && m[7] == 0.0f && m[11] < 0.0f && m[15] == 0.0f && m[12] == 0.0f && m[13] == 0.0f;
        int orthographic = m[3] == 0.0f && m[7] == 0.0f && m[11] == 0.0f && m[15] == 1.0f && m[8] == 0.0f && m[9] == 0.0f;
        if (!(perspective || orthographic) || m[0] == 0.0f || m[5] == 0.0f || m[1] != 0.0f || m[4] != 0.0f)
            SBL__MISTAKE(&check, item, "sbl_picture_desc: view_to_clip is neither a perspective nor an orthographic projection (column-major, looking down -z; "
                         "its last row is %g %g %g %g); sbl_perspective makes one", (double)m[3], (double)m[7], (double)m[11], (double)m[15]);
    }
    if (check.mistakes) return SBL_ERROR_INVALID_ARGUMENT;
    if (d->mode == SBL_MODE_GI) {
        sbl__log(&c->base, SBL_LOG_ERROR, SBL_LOG_ITEM_NOT_IMPLEMENTED, "sbl_picture_desc: mode is SBL_MODE_GI; this version has no bounced light yet, use SBL_MODE_AMBIENT or SBL_MODE_DIRECT");
        return SBL_ERROR_UNSUPPORTED;
    }
    if (d->width > c->gl.capabilities.max_texture_size || d->height > c->gl.capabilities.max_texture_size) {
        sbl__log(&c->base, SBL_LOG_ERROR, SBL_LOG_ITEM_TOO_LARGE, "sbl_picture_desc: size is %d x %d; this driver's textures are at most %d across", d->width, d->height, c->gl.capabilities.max_texture_size);
        return SBL_ERROR_UNSUPPORTED;
    }
    return SBL_SUCCESS;
}

/* A camera that frames the scene: from the front (+z), a little to the right and above. */
static void sbl__default_camera(const sbl__scene *s, sbl_picture_desc *d) {
    double radius = 0, distance;
    float c[3];
    int k;
    for (k = 0; k < 3; k++) {
        double half = 0.5 * ((double)s->bounds[1][k] - s->bounds[0][k]);
        radius += half * half;
        c[k] = (float)(0.5 * ((double)s->bounds[1][k] + s->bounds[0][k]));
    }
    radius = radius > 0 ? sqrt(radius) : 1;
    distance = d->view_to_clip[11] != 0.0f ? radius * sqrt(1 + pow(SBL__MIN(fabs((double)d->view_to_clip[0]), fabs((double)d->view_to_clip[5])), 2)) : 2 * radius;
    sbl_look_at(d->world_to_view, c[0] + (float)(0.35 * distance), c[1] + (float)(0.3 * distance), c[2] + (float)(0.89 * distance), c[0], c[1], c[2], 0, 1, 0);
}


static void sbl__log_state(const sbl_context *c, const char *function, const char *needs) {
    sbl__log(&c->base, SBL_LOG_ERROR, SBL_LOG_ITEM_WRONG_ORDER, "%s: %s", function, needs);
}

/* All but the struct itself. A context that sbl_create gave up half-way is freed too. */
static void sbl__context_free(sbl_context *c) {
    if (c->gl.GetError && c->gl.capabilities.gl_major) {
        unsigned *programs = &c->programs.gbuffer;
        sbl__visit visit;
        int i;
        sbl__visit_enter(c, &visit);
        sbl__picture_free(c);
        sbl__scene_free(&c->gl, &c->scene);
        for (i = 0; i < (int)(sizeof c->programs / sizeof(unsigned)); i++) if (programs[i]) c->gl.DeleteProgram(programs[i]);
        sbl__name_delete(c->gl.DeleteVertexArrays, &c->empty_array);
        sbl__visit_leave(c, &visit);
    }
#ifdef SBL_EGL
    if (c->owns_egl) {
        if (eglGetCurrentContext() == c->egl_context) eglMakeCurrent(c->egl_display, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT);
        if (c->egl_surface != EGL_NO_SURFACE) eglDestroySurface(c->egl_display, c->egl_surface);
        eglDestroyContext(c->egl_display, c->egl_context);
    }
#endif
}

SBL_API sbl_result sbl_create(const sbl_context_desc *desc, sbl_context **out) {
    sbl_context_desc d = sbl_context_desc_defaults(desc);
    sbl_context *c;
    sbl__base base;
    sbl_result result;
    sbl__visit visit;
    memset(&base, 0, sizeof base);
    base.allocator = d.allocator;
    base.logger = d.logger;
    memset(&visit, 0, sizeof visit);
    if (!out) {
        sbl__log(&base, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_ARGUMENT, "sbl_create: out is NULL; it receives the context");
        return SBL_ERROR_INVALID_ARGUMENT;
    }
    *out = NULL;
    result = sbl__check_context_desc(&base, &d);
    if (result != SBL_SUCCESS) return result;
    c = (sbl_context *)sbl__alloc(&base, 1, sizeof *c);
    if (!c) return SBL_ERROR_OUT_OF_MEMORY;
    c->base = base;
    c->desc = d;
    c->gl.base = &c->base;
    if (!d.get_gl_function) {
#ifdef SBL_EGL
        sbl__egl_save(&visit);
        result = sbl__egl_create(c);
        d.get_gl_function = sbl__egl_proc;
#else
        sbl__log(&c->base, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_CONTEXT_DESC, "sbl_context_desc: get_gl_function is NULL; give the loader of your GL context, or define SBL_EGL for a headless one");
        result = SBL_ERROR_INVALID_ARGUMENT;
#endif
    }
    if (result == SBL_SUCCESS) result = sbl__gl_load(&c->gl, &c->base, &d);
    if (result == SBL_SUCCESS) {
        sbl__guard_save(&c->gl, &visit.guard);
        sbl__guard_force(&c->gl);
        result = sbl__programs_make(c);
        sbl__guard_restore(&c->gl, &visit.guard);
        sbl__gl_clear_errors(&c->gl);
    }
    if (result != SBL_SUCCESS) sbl__context_free(c);
#ifdef SBL_EGL
    sbl__egl_restore(c, &visit);
#endif
    if (result != SBL_SUCCESS) {
        base = c->base;
        sbl__free(&base, c);
        return result;
    }
    *out = c;
    return SBL_SUCCESS;
}

SBL_API void sbl_destroy(sbl_context *c) {
    sbl__base base;
    if (!c) return;
    sbl__context_free(c);
    base = c->base;
    sbl__free(&base, c);
}

SBL_API sbl_result sbl_set_scene(sbl_context *c, const sbl_scene_desc *desc) {
    double start = sbl__now();
    sbl__scene scene;
    sbl__visit visit;
    sbl_result result;
    if (!c) return SBL_ERROR_INVALID_ARGUMENT;
    if (!desc) {
        sbl__log(&c->base, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_ARGUMENT, "sbl_set_scene: desc is NULL");
        return SBL_ERROR_INVALID_ARGUMENT;
    }
    memset(&scene, 0, sizeof scene);
    sbl__visit_enter(c, &visit);
    result = sbl__scene_make(&c->gl, &scene, desc, c->programs.copy, c->empty_array);
    if (result == SBL_SUCCESS && scene.wide != c->wide) {
        result = sbl__scene_programs_make(c, scene.wide);
        if (result != SBL_SUCCESS) sbl__scene_free(&c->gl, &scene);
    }
    if (result == SBL_SUCCESS) {
        sbl__picture_free(c);
        sbl__scene_free(&c->gl, &c->scene);
        c->scene = scene;
        c->has_scene = 1;
        memset(&c->stats, 0, sizeof c->stats);
        c->stats.triangles = scene.triangle_count;
        c->stats.seconds.scene = sbl__now() - start;
    }
    sbl__visit_leave(c, &visit);
    return result;
}

SBL_API sbl_result sbl_set_mesh_transform(sbl_context *c, int mesh, const float transform[16]) {
    sbl__visit visit;
    sbl__check check;
    sbl_result result;
    if (!c) return SBL_ERROR_INVALID_ARGUMENT;
    if (!c->has_scene) { sbl__log_state(c, "sbl_set_mesh_transform", "there is no scene yet; call sbl_set_scene first"); return SBL_ERROR_STATE; }
    check.base = &c->base;
    check.mistakes = 0;
    if (mesh < 0 || mesh >= c->scene.mesh_count) SBL__MISTAKE(&check, SBL_LOG_ITEM_INVALID_ARGUMENT, "sbl_set_mesh_transform: mesh is %d; the scene has %d", mesh, c->scene.mesh_count);
    if (!transform) SBL__MISTAKE(&check, SBL_LOG_ITEM_INVALID_ARGUMENT, "sbl_set_mesh_transform: transform is NULL");
    else sbl__check_transform(&check, mesh, transform);
    if (check.mistakes) return SBL_ERROR_INVALID_ARGUMENT;
    sbl__visit_enter(c, &visit);
    sbl__picture_free(c);
    result = sbl__scene_move(&c->gl, &c->scene, mesh, transform);
    sbl__visit_leave(c, &visit);
    return result;
}

SBL_API sbl_result sbl_query_bounds(const sbl_context *c, float lowest[3], float highest[3]) {
    if (!c) return SBL_ERROR_INVALID_ARGUMENT;
    if (!lowest || !highest) {
        sbl__log(&c->base, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_ARGUMENT, "sbl_query_bounds: %s is NULL", lowest ? "highest" : "lowest");
        return SBL_ERROR_INVALID_ARGUMENT;
    }
    if (!c->has_scene) { sbl__log_state(c, "sbl_query_bounds", "there is no scene yet; call sbl_set_scene first"); return SBL_ERROR_STATE; }
    memcpy(lowest, c->scene.bounds[0], 3 * sizeof(float));
    memcpy(highest, c->scene.bounds[1], 3 * sizeof(float));
    return SBL_SUCCESS;
}

SBL_API sbl_result sbl_begin(sbl_context *c, const sbl_picture_desc *desc) {
    sbl_picture_desc d = sbl_picture_desc_defaults(desc);
    sbl__visit visit;
    sbl_result result;
    double start = sbl__now(), scene_seconds;
    int triangles, level;
    if (!c) return SBL_ERROR_INVALID_ARGUMENT;
    if (!c->has_scene) { sbl__log_state(c, "sbl_begin", "there is no scene yet; call sbl_set_scene first"); return SBL_ERROR_STATE; }
    if (sbl__all_zero(d.world_to_view, 16)) sbl__default_camera(&c->scene, &d);
    if (d.backend == SBL_BACKEND_AUTO)  /* a rule, not a stopwatch: the same input gives the same picture */
        d.backend = d.mode == SBL_MODE_PAPER || c->scene.draw || d.sensor_kind == SBL_SENSOR_SINGLE ? SBL_BACKEND_RASTER : SBL_BACKEND_TRACE;
    result = sbl__check_picture_desc(c, desc, &d);
    if (result != SBL_SUCCESS) return result;
    sbl__visit_enter(c, &visit);
    sbl__picture_free(c);
    scene_seconds = c->stats.seconds.scene;
    triangles = c->stats.triangles;
    memset(&c->stats, 0, sizeof c->stats);
    c->stats.triangles = triangles;
    c->stats.mode = d.mode;
    c->stats.backend = d.backend;
    c->stats.width = d.width;
    c->stats.height = d.height;
    for (level = 0; level < SBL_MAX_LEVELS; level++) c->stats.levels[level].tile = SBL__MAX(1, d.tile >> level);
    c->picture.desc = d;
    result = sbl__picture_begin(c);
    if (result != SBL_SUCCESS) sbl__picture_free(c);
    c->stats.seconds.scene = scene_seconds;
    c->stats.seconds.total = sbl__now() - start;
    sbl__visit_leave(c, &visit);
    return result;
}

SBL_API sbl_result sbl_step(sbl_context *c, double seconds) {
    double start = sbl__now(), before = start, rate = 0;
    int worked = 0;
    sbl__visit visit;
    sbl_result result = SBL_SUCCESS;
    if (!c) return SBL_ERROR_INVALID_ARGUMENT;
    if (c->picture.stage == SBL__STAGE_NONE) { sbl__log_state(c, "sbl_step", "there is no picture; call sbl_begin first"); return SBL_ERROR_STATE; }
    if (c->picture.stage == SBL__STAGE_DONE) return SBL_SUCCESS;
    sbl__visit_enter(c, &visit);
    while (result == SBL_SUCCESS && c->picture.stage != SBL__STAGE_DONE) {
        int limit = INT_MAX, gathering = c->picture.stage == SBL__STAGE_GATHER, from = c->gather.next;
        double now = sbl__now();
        if (seconds > 0) {
            if (worked && now - start >= seconds) break;
            limit = rate > 0 ? (int)SBL__MIN(1e6, (seconds - (now - start)) * rate) : 16;
        }
        result = sbl__picture_work(c, limit);
        worked = 1;
        if (seconds > 0 && gathering) {  /* how fast sensors go here, for the next limit */
            c->gl.Finish();
            rate = SBL__MAX(1, c->gather.next - from) / SBL__MAX(sbl__now() - now, 1e-6);
        }
        if (result == SBL_SUCCESS) result = sbl__gl_check(&c->gl, "rendering");
        c->picture.progress = SBL__MAX(c->picture.progress, sbl__picture_progress(c));
        c->stats.seconds.total += sbl__now() - before;
        before = sbl__now();
        if (result == SBL_SUCCESS && c->picture.desc.progress && c->picture.desc.progress(c->picture.progress, c->picture.desc.progress_user)) result = SBL_CANCELLED;
    }
    c->stats.microseconds_per_sensor = c->stats.sensors ? 1e6 * c->stats.seconds.total / (double)c->stats.sensors : 0;
    if (result == SBL_SUCCESS && c->picture.stage != SBL__STAGE_DONE) result = SBL_UNFINISHED;
    else if (result != SBL_SUCCESS) sbl__picture_free(c);
    sbl__visit_leave(c, &visit);
    return result;
}

SBL_API sbl_result sbl_render(sbl_context *c, const sbl_picture_desc *desc) {
    sbl_result result = sbl_begin(c, desc);
    return result == SBL_SUCCESS ? sbl_step(c, 0) : result;
}

SBL_API float sbl_progress(const sbl_context *c) { return c ? c->picture.progress : 0; }

SBL_API void sbl_end(sbl_context *c) {
    sbl__visit visit;
    if (!c || c->picture.stage == SBL__STAGE_NONE) return;
    sbl__visit_enter(c, &visit);
    sbl__picture_free(c);
    sbl__visit_leave(c, &visit);
}

SBL_API int sbl_channel_components(sbl_channel channel) {
    if ((int)channel < 0 || channel >= SBL_CHANNEL_COUNT) return 0;
    return channel >= SBL_CHANNEL_ID ? 1 : 3;
}

/* DEPTH or SENSORS of pixel i */
static float sbl__scalar(const sbl_context *c, sbl_channel channel, size_t i) {
    const sbl__pixel *p = &c->picture.refine.pixels[i];
    double depth = 0;
    int k;
    if (!p->id) return 0;
    if (channel == SBL_CHANNEL_SENSORS) return p->level;
    for (k = 0; k < 3; k++) depth -= c->picture.camera.back[k] * ((double)p->position[k] - c->picture.camera.eye[k]);
    return (float)depth;
}

SBL_API sbl_result sbl_read_channel(sbl_context *c, sbl_channel channel, float *out, size_t count) {
    sbl__picture *p;
    size_t pixels, i;
    int components = sbl_channel_components(channel), k;
    sbl_result result = SBL_SUCCESS;
    sbl__visit visit;
    if (!c) return SBL_ERROR_INVALID_ARGUMENT;
    p = &c->picture;
    if (!components || !out) {
        sbl__log(&c->base, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_ARGUMENT, "sbl_read_channel: channel is %d (0 to %d exist), out is %s", (int)channel, SBL_CHANNEL_COUNT - 1, out ? "given" : "NULL");
        return SBL_ERROR_INVALID_ARGUMENT;
    }
    if (p->stage != SBL__STAGE_DONE) { sbl__log_state(c, "sbl_read_channel", "there is no finished picture; call sbl_render, or sbl_step until it gives SBL_SUCCESS"); return SBL_ERROR_STATE; }
    pixels = (size_t)p->desc.width * (size_t)p->desc.height;
    if (count < pixels * (size_t)components) {
        sbl__log(&c->base, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_ARGUMENT, "sbl_read_channel: count is %.0f; channel %d of %d x %d pixels needs %.0f floats", (double)count, (int)channel,
                 p->desc.width, p->desc.height, (double)pixels * components);
        return SBL_ERROR_INVALID_ARGUMENT;
    }
    if (channel == SBL_CHANNEL_FINAL || channel == SBL_CHANNEL_RADIANCE || channel == SBL_CHANNEL_ALBEDO) {
        float *data = (float *)sbl__alloc(&c->base, pixels, 16);
        int final = p->resolved & 1;
        if (!data) return SBL_ERROR_OUT_OF_MEMORY;
        sbl__visit_enter(c, &visit);
        if (channel == SBL_CHANNEL_FINAL) result = sbl__read_pixels(&c->gl, p->final_framebuffers[final], 0, &p->finals[final], p->desc.height, data, "reading a channel");
        else if (channel == SBL_CHANNEL_RADIANCE) result = sbl__read_pixels(&c->gl, p->filter_framebuffer, 0, &p->filtered, p->desc.height, data, "reading a channel");
        else result = sbl__read_pixels(&c->gl, p->gbuffer.framebuffer, 3, &p->gbuffer.albedo, p->desc.height, data, "reading a channel");
        sbl__visit_leave(c, &visit);
        for (i = 0; i < pixels && result == SBL_SUCCESS; i++) for (k = 0; k < 3; k++) out[3 * i + (size_t)k] = data[4 * i + (size_t)k];
        sbl__free(&c->base, data);
        return result;
    }
    for (i = 0; i < pixels; i++) {
        const sbl__pixel *pixel = &p->refine.pixels[i];
        if (channel == SBL_CHANNEL_ID) out[i] = (float)pixel->id;
        else if (components == 1) out[i] = sbl__scalar(c, channel, i);
        else for (k = 0; k < 3; k++) out[3 * i + (size_t)k] = !pixel->id ? 0 : channel == SBL_CHANNEL_NORMAL ? pixel->normal[k] : pixel->position[k];
    }
    return SBL_SUCCESS;
}

SBL_API uint32_t sbl_channel_texture(sbl_context *c, sbl_channel channel) {
    sbl__picture *p;
    size_t pixels, i;
    float *data;
    sbl__visit visit;
    if (!c || c->picture.stage != SBL__STAGE_DONE) return 0;
    p = &c->picture;
    switch (channel) {
        case SBL_CHANNEL_FINAL: return p->finals[p->resolved & 1].id;
        case SBL_CHANNEL_RADIANCE: return p->filtered.id;
        case SBL_CHANNEL_ALBEDO: return p->gbuffer.albedo.id;
        case SBL_CHANNEL_NORMAL: return p->gbuffer.normal.id;
        case SBL_CHANNEL_POSITION: return p->gbuffer.position.id;
        case SBL_CHANNEL_ID: return p->gbuffer.id.id;
        case SBL_CHANNEL_DEPTH: case SBL_CHANNEL_SENSORS: break;
        default: return 0;
    }
    pixels = (size_t)p->desc.width * (size_t)p->desc.height;
    data = (float *)sbl__alloc(&c->base, pixels, sizeof(float));
    if (!data) return 0;
    for (i = 0; i < pixels; i++) data[i] = sbl__scalar(c, channel, i);
    sbl__visit_enter(c, &visit);
    sbl__texture_make(&c->gl, &p->scalars[channel == SBL_CHANNEL_SENSORS], p->desc.width, p->desc.height, SBL__GL_R32F, data, "making a channel's texture");
    sbl__visit_leave(c, &visit);
    sbl__free(&c->base, data);
    return p->scalars[channel == SBL_CHANNEL_SENSORS].id;
}

/* Traced sensors have no texels, and rasterised ones none with lamps: what is shown is one that rasterises all. */
static int sbl__inspects_apart(const sbl_context *c) { return c->gather.rays || c->gather.lamp_rays; }

/* Gathers for a pixel in the slot that its sensor had, so that every rounding is the same, and reads its sheet. */
static sbl_result sbl__inspect(sbl_context *c, const sbl__site *site, int pixel, int index, sbl__reading *reading, float *radiance, float *weights) {
    sbl__gather *g = sbl__inspects_apart(c) ? &c->inspected : &c->gather;
    const sbl__layout *l = &g->layout;
    const unsigned reduce[2] = { c->programs.reduce_blocks, c->programs.reduce_sum };
    const unsigned program[3] = { c->scene.textured ? c->programs.sensor_textured[0] : c->programs.sensor[0], c->programs.sky, 0 };  /* no lamps apart */
    int pitch_x = l->blocks[0] * l->block, slot = index % g->slots, x, y, k;
    sbl__site *sites = (sbl__site *)sbl__alloc(&c->base, (size_t)slot + 1, sizeof *sites);
    sbl__reading *readings = (sbl__reading *)sbl__alloc(&c->base, (size_t)slot + 1, sizeof *readings);
    float *atlas = radiance ? (float *)sbl__alloc(&c->base, (size_t)g->atlas.width * (size_t)g->atlas.height, 16) : NULL;
    float *table = (float *)sbl__alloc(&c->base, (size_t)pitch_x * (size_t)(l->blocks[1] * l->block), 8);
    sbl_result result = SBL_SUCCESS;
    if (!sites || !readings || (radiance && !atlas) || !table) result = SBL_ERROR_OUT_OF_MEMORY;
    if (result == SBL_SUCCESS) {
        sites[slot] = *site;
        result = sbl__gather_begin(&c->gl, g, sites, slot + 1);
        sbl__gather_clear(&c->gl, g, &c->scene);
    }
    if (result == SBL_SUCCESS) result = sbl__gather_draw(&c->gl, g, &c->scene, program, slot, 1);
    if (result == SBL_SUCCESS) {
        sbl__gather_reduce(&c->gl, g, reduce, c->empty_array, slot);
        result = sbl__gather_finish(&c->gl, g, readings);
    }
    if (result == SBL_SUCCESS) *reading = readings[slot];
    if (result == SBL_SUCCESS && reading->back_share > SBL__SUSPECT_SHARE) {
        sbl__reading answer = { { 0, 0, 0 }, 0, 0, 0, 0, 0, 0 };
        sbl__probe_site(&c->picture.refine, pixel, site, &sites[0]);
        result = sbl__probe_begin(c, sites, 1);
        if (result == SBL_SUCCESS) result = sbl__gather_step(&c->gl, &c->probe, &c->scene, c->probe.rays ? c->scene.textured ? c->programs.trace_textured : c->programs.trace : program, reduce, c->empty_array, 1);
        if (result == SBL_SUCCESS) result = sbl__gather_finish(&c->gl, &c->probe, &answer);
        reading->stuck = sbl__probe_stuck(&c->picture.refine.pixels[pixel], &answer);
    }
    if (result == SBL_SUCCESS) sbl__weights_make(l, g->paper, table);
    if (result == SBL_SUCCESS && radiance) {
        result = sbl__read_pixels(&c->gl, g->atlas_framebuffer, 0, &g->atlas, g->atlas.height, atlas, "reading a sensor's sheet");
        for (y = 0; y < l->sheet_height && result == SBL_SUCCESS; y++)
            for (x = 0; x < l->sheet_width; x++) {
                const float *from = atlas + 4 * ((size_t)(slot / g->columns * l->blocks[1] * l->block + y) * (size_t)g->atlas.width + (size_t)(slot % g->columns * pitch_x + x));
                float *to = radiance + 4 * ((size_t)y * (size_t)l->sheet_width + (size_t)x);
                for (k = 0; k < 3; k++) to[k] = from[k] / g->radiance_scale;
                to[3] = from[3] * c->scene.extent * table[2 * ((size_t)y * (size_t)pitch_x + (size_t)x) + 1];
            }
    }
    if (result == SBL_SUCCESS && weights) {
        for (y = 0; y < l->sheet_height; y++)
            for (x = 0; x < l->sheet_width; x++) weights[(size_t)y * (size_t)l->sheet_width + (size_t)x] = table[2 * ((size_t)y * (size_t)pitch_x + (size_t)x)];
    }
    sbl__free(&c->base, sites);
    sbl__free(&c->base, readings);
    sbl__free(&c->base, atlas);
    sbl__free(&c->base, table);
    return result;
}

SBL_API sbl_result sbl_inspect_sensor(sbl_context *c, int x, int y, sbl_sensor *sensor, float *radiance, float *weights, size_t count) {
    const sbl__pixel *p;
    const sbl__layout *l;
    sbl__site site;
    sbl__reading reading = { { 0, 0, 0 }, 0, 0, 0, 0, 0, 0 };
    sbl__visit visit;
    float *table;
    double sum = 0;
    size_t i, texels;
    int face, k;
    sbl_result result;
    if (!c) return SBL_ERROR_INVALID_ARGUMENT;
    if (!sensor) {
        sbl__log(&c->base, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_ARGUMENT, "sbl_inspect_sensor: sensor is NULL");
        return SBL_ERROR_INVALID_ARGUMENT;
    }
    if (c->picture.stage != SBL__STAGE_DONE) { sbl__log_state(c, "sbl_inspect_sensor", "there is no finished picture; call sbl_render first"); return SBL_ERROR_STATE; }
    if (x < 0 || y < 0 || x >= c->picture.desc.width || y >= c->picture.desc.height) {
        sbl__log(&c->base, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_ARGUMENT, "sbl_inspect_sensor: pixel %d %d lies outside of the picture's %d x %d", x, y, c->picture.desc.width, c->picture.desc.height);
        return SBL_ERROR_INVALID_ARGUMENT;
    }
    p = &c->picture.refine.pixels[(size_t)y * (size_t)c->picture.desc.width + (size_t)x];
    if (!p->id) {
        sbl__log(&c->base, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_ARGUMENT, "sbl_inspect_sensor: pixel %d %d shows no surface", x, y);
        return SBL_ERROR_INVALID_ARGUMENT;
    }
    if (sbl__inspects_apart(c) && !c->inspected.atlas.id) {
        sbl__visit_enter(c, &visit);
        result = sbl__picture_raster(c, &c->inspected, 0);
        sbl__visit_leave(c, &visit);
        if (result != SBL_SUCCESS) return result;
    }
    l = sbl__inspects_apart(c) ? &c->inspected.layout : &c->gather.layout;
    texels = (size_t)l->sheet_width * (size_t)l->sheet_height;
    if ((radiance || weights) && count < texels) {
        sbl__log(&c->base, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_ARGUMENT, "sbl_inspect_sensor: count is %.0f; the sheet has %d x %d texels", (double)count, l->sheet_width, l->sheet_height);
        return SBL_ERROR_INVALID_ARGUMENT;
    }
    table = weights ? NULL : (float *)sbl__alloc(&c->base, texels, sizeof(float));
    if (!weights && !table) return SBL_ERROR_OUT_OF_MEMORY;
    sbl__refine_site(&c->picture.refine, y * c->picture.desc.width + x, 0, &site);
    sbl__visit_enter(c, &visit);
    result = sbl__inspect(c, &site, y * c->picture.desc.width + x, p->job, &reading, radiance, weights ? weights : table);
    sbl__visit_leave(c, &visit);
    if (result == SBL_SUCCESS) {
        memset(sensor, 0, sizeof *sensor);
        for (i = 0; i < texels; i++) sum += (double)(weights ? weights : table)[i];
        for (k = 0; k < 3; k++) {
            sensor->position[k] = site.position[k];
            sensor->normal[k] = site.normal[k];
            sensor->radiance[k] = reading.radiance[k];
        }
        sensor->weight_sum = (float)sum;
        sensor->back_share = reading.back_share * reading.hit_share;
        sensor->hit_min = reading.hit_min;
        sensor->hit_mean = reading.hit_mean;
        sensor->valid = !reading.stuck;
        sensor->sensed = p->sensed;
        sensor->level = p->level ? p->level - 1 : 0;
        sensor->view_count = l->view_count;
        sensor->sheet_width = l->sheet_width;
        sensor->sheet_height = l->sheet_height;
        for (face = 0; face < l->view_count; face++) {
            sbl_sensor_view *v = &sensor->views[face];
            double right[3], up[3], forward[3], range[4];
            memcpy(v->rect, l->rects[face], sizeof v->rect);
            sbl__view_axes(&site, face, right, up, forward);
            sbl__view_range(l, face, range);
            for (k = 0; k < 3; k++) { v->right[k] = (float)right[k]; v->up[k] = (float)up[k]; v->forward[k] = (float)forward[k]; }
            v->x0 = (float)range[0]; v->x1 = (float)range[1]; v->y0 = (float)range[2]; v->y1 = (float)range[3];
        }
    }
    sbl__free(&c->base, table);
    return result;
}

SBL_API int sbl_look_at(float m[16], float eye_x, float eye_y, float eye_z, float at_x, float at_y, float at_z, float up_x, float up_y, float up_z) {
    double eye[3], f[3], u[3], r[3];
    int k;
    eye[0] = eye_x; eye[1] = eye_y; eye[2] = eye_z;
    f[0] = at_x - eye[0]; f[1] = at_y - eye[1]; f[2] = at_z - eye[2];
    u[0] = up_x; u[1] = up_y; u[2] = up_z;
    if (!sbl__normalize(f) || !sbl__normalize(u)) return 0;
    r[0] = f[1] * u[2] - f[2] * u[1]; r[1] = f[2] * u[0] - f[0] * u[2]; r[2] = f[0] * u[1] - f[1] * u[0];
    if (r[0] * r[0] + r[1] * r[1] + r[2] * r[2] < 1e-12 || !sbl__normalize(r)) return 0;
    u[0] = r[1] * f[2] - r[2] * f[1]; u[1] = r[2] * f[0] - r[0] * f[2]; u[2] = r[0] * f[1] - r[1] * f[0];
    for (k = 0; k < 3; k++) {
        m[4 * k] = (float)r[k];
        m[4 * k + 1] = (float)u[k];
        m[4 * k + 2] = (float)-f[k];
        m[4 * k + 3] = 0;
    }
    m[12] = (float)-(r[0] * eye[0] + r[1] * eye[1] + r[2] * eye[2]);
    m[13] = (float)-(u[0] * eye[0] + u[1] * eye[1] + u[2] * eye[2]);
    m[14] = (float)(f[0] * eye[0] + f[1] * eye[1] + f[2] * eye[2]);
    m[15] = 1;
    return 1;
}

SBL_API int sbl_perspective(float m[16], float fov_y, float aspect) {
    double t;
    if (!(fov_y > 0 && fov_y < 180 && aspect > 0 && sbl__finite(aspect))) return 0;
    t = tan(0.5 * fov_y * SBL__PI / 180);
    memset(m, 0, 16 * sizeof(float));
    m[0] = (float)(1 / (t * aspect));
    m[5] = (float)(1 / t);
    m[10] = -1;
    m[11] = -1;
    m[14] = -0.2f;  /* near 0.1, no far plane; sbl.h itself ignores both */
    return 1;
}

SBL_API sbl_context_desc sbl_query_desc(const sbl_context *c) { return c ? c->desc : sbl_context_desc_defaults(NULL); }

SBL_API sbl_capabilities sbl_query_capabilities(const sbl_context *c) {
    sbl_capabilities none;
    memset(&none, 0, sizeof none);
    return c ? c->gl.capabilities : none;
}

SBL_API sbl_stats sbl_query_stats(const sbl_context *c) {
    sbl_stats none;
    memset(&none, 0, sizeof none);
    return c ? c->stats : none;
}

SBL_API sbl_memory sbl_query_memory(const sbl_context *c) {
    sbl_memory none;
    memset(&none, 0, sizeof none);
    return c ? c->base.memory : none;
}

SBL_API const char *sbl_version(void) { return "0.1.0"; }

SBL_API const char *sbl_result_string(sbl_result result) {
    static const char *const words[SBL_RESULT_COUNT] = {
        "success", "unfinished: call sbl_step again", "cancelled by the progress callback", "invalid argument", "out of memory",
        "unsupported by the GL context or this version", "called in the wrong order", "GL error"
    };
    return (int)result >= 0 && result < SBL_RESULT_COUNT ? words[result] : "unknown result";
}

SBL_API const char *sbl_log_item_string(sbl_log_item item) {
#define SBL__X(name, text) text,
    static const char *const words[SBL_LOG_ITEM_COUNT] = { SBL_LOG_ITEMS(SBL__X) };
#undef SBL__X
    return (int)item >= 0 && item < SBL_LOG_ITEM_COUNT ? words[item] : "unknown log item";
}

#endif /* SBL_IMPLEMENTATION_INCLUDED */
#endif /* SBL_IMPLEMENTATION */
