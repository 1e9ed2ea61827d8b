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

   No light that bounces yet (SBL_MODE_GI is refused), no point, spot or sun lights, no sky pictures, no glossy or
   transparent surfaces (a metal is read as its base colour), no textures smaller than their texels seen from afar
   (bilinear filtering, no mip maps). It opens no files and creates no windows.


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
           sbl_material materials[2] = { { { 0.7f, 0.7f, 0.7f } }, { { 0, 0, 0 } } };
           sbl_mesh meshes[2] = { { 0 }, { 0 } };
           sbl_scene_desc scene = { 0 };
           sbl_picture_desc view = { 0 };
           sbl_context *context;
           int i;
           for (i = 0; i < 3; i++) materials[1].emission[i] = 5;
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
       sbl_set_scene              replaces the scene: meshes, materials, textures, sky
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
   cancel too: framebuffers, program, vertex array, buffers, textures and samplers of the units they use, viewport,
   scissor, depth, stencil, blend, cull, masks, clear values, polygon mode, pixel store, sRGB, clip distances, depth
   clamp, clip control, and so on. With a headless context of its own the EGL binding is put back instead. GL errors
   that the host left behind are cleared. All sbl functions that touch GL need the same GL context current that
   sbl_create was called in; sbl_destroy too.

   ON DETERMINISM

   Sensor rotations come from a hash of pixel and seed. The same input gives the same picture, bit for bit, on the same GL driver,
   whatever the batch size, the slices and the number of repetitions; between GL paths and drivers it agrees up to rounding.

   ON THE PAPER

   SBL_MODE_PAPER is the paper: one view of 135 degrees, equation 4, epsilon, the absolute threshold, the Gaussian on one id.
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
  #ifdef SBL_STATIC
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
    SBL_CAPABILITY_ALL = (1 << 1) - 1
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
    int max_texture_buffer_size;  /* texels */
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
    float sky[3];              /* constant radiance of all that is not hit */
    sbl_draw_function draw;    /* optional: see sbl_draw_view */
    void *draw_user;
    float draw_bounds[2][3];   /* world bounds (lowest corner, highest corner) of what draw draws; required with it */
    float draw_max_radiance;   /* highest radiance that draw writes, so that texels do not overflow. Default: 1 */
    uint32_t end_canary;
} sbl_scene_desc;

/* >>picture types */

typedef enum sbl_mode {
    SBL_MODE_DEFAULT = 0,  /* AMBIENT, until bounced light exists: then GI */
    SBL_MODE_AMBIENT,      /* emitters, sky, and every other surface glowing with epsilon * albedo: the paper's estimator over the whole hemisphere */
    SBL_MODE_DIRECT,       /* emitters and sky only */
    SBL_MODE_PAPER,        /* exactly the paper */
    SBL_MODE_GI,           /* all bounces: SBL_ERROR_UNSUPPORTED in this version */
    SBL_MODE_COUNT
} sbl_mode;

typedef enum sbl_preset { SBL_PRESET_DEFAULT = 0, SBL_PRESET_DRAFT, SBL_PRESET_HIGH, SBL_PRESET_COUNT } sbl_preset;

typedef enum sbl_sensor_kind {
    SBL_SENSOR_DEFAULT = 0,  /* HEMICUBE; SINGLE in SBL_MODE_PAPER */
    SBL_SENSOR_HEMICUBE,     /* five views, the whole hemisphere */
    SBL_SENSOR_SINGLE,       /* the paper's one view along the normal, sensor_fov wide, blind outside */
    SBL_SENSOR_KIND_COUNT
} sbl_sensor_kind;

/* Zero is the default everywhere. Where two or three numbers stand: draft / default / high preset. */
typedef struct sbl_picture_desc {
    uint32_t start_canary;
    int width, height;         /* pixels, 1 to 16384. Default: 640 480 */
    float world_to_view[16];   /* rigid. Default (all zero): frames the scene from the front, see sbl_look_at */
    float view_to_clip[16];    /* perspective or orthographic; its near and far planes are ignored. Default: 40 degrees */
    sbl_mode mode;
    sbl_preset preset;
    sbl_sensor_kind sensor_kind;
    int sensor_size;           /* texels across a view, 4 to 512. Default: 32 / 64 / 128 */
    float sensor_fov;          /* degrees, SBL_SENSOR_SINGLE only, 1 to 179. Default: 135 */
    int tile;                  /* first distance between sensors in pixels, 1 (every pixel) to 1024. Default: 16 / 16 / 8 */
    float threshold;           /* refine where neighbours differ by more: a share of their mean, in SBL_MODE_PAPER a radiance. Default: 0.2 / 0.1 / 0.05, paper 0.05 */
    float epsilon;             /* ambient factor. Default: 0.02 (SBL_MODE_DIRECT: always 0) */
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
    int width, height;
    int triangles;            /* in the scene, degenerate ones left out */
    int visible_pixels;       /* pixels that show a surface */
    int64_t sensors;          /* points at which light was gathered */
    int64_t sensor_views;     /* views drawn for them */
    int64_t sensor_texels;
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
    float radiance[3];        /* R: the sum over texels of weight * radiance, before interpolation and filter */
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
