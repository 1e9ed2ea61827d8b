/* tests/test_glx.sh runs this program on an X server. It tests contexts of sbl.h in a thread where a GLX context is
   current. The program is a host that draws with GLX; sbl.h must never change its textures. */
#include <GL/glx.h>
#include "../../sbl.h"
#include "test.h"
#include "scenes.h"
#include "gl_watch.h"

enum { SIDE = 16, TEXTURES = 40 };

static Display *display;
static GLXContext host;
static GLXPbuffer surface;
static GLuint textures[TEXTURES];
static watch seen;

static int host_is_current(int current) {
    return current ? glXMakeContextCurrent(display, surface, surface, host)
                   : glXMakeContextCurrent(display, None, None, NULL);
}

/* Creates the context of the host, makes it current, and fills its textures. */
static int host_begin(void) {
    static const int wishes[] = { GLX_RENDER_TYPE, GLX_RGBA_BIT, GLX_DRAWABLE_TYPE, GLX_PBUFFER_BIT, None };
    static const int size[] = { GLX_PBUFFER_WIDTH, SIDE, GLX_PBUFFER_HEIGHT, SIDE, None };
    GLXFBConfig *configs;
    int count = 0, i;
    display = XOpenDisplay(NULL);
    configs = display ? glXChooseFBConfig(display, DefaultScreen(display), wishes, &count) : NULL;
    if (!count) return 0;
    surface = glXCreatePbuffer(display, configs[0], size);
    host = glXCreateNewContext(display, configs[0], GLX_RGBA_TYPE, NULL, True);
    XFree(configs);
    if (!host || !host_is_current(1)) return 0;
    glGenTextures(TEXTURES, textures);
    for (i = 0; i < TEXTURES; i++) glBindTexture(GL_TEXTURE_2D, textures[i]);
    return 1;
}

/* Checks that the context of the host is current and its textures are unchanged. */
static void host_is_whole(const char *when) {
    int i, kept = 0;
    CHECK(glXGetCurrentContext() == host, "%s: the host's context is not current", when);
    for (i = 0; i < TEXTURES; i++) kept += glIsTexture(textures[i]);
    CHECK(kept == TEXTURES && !glIsTexture(textures[TEXTURES - 1] + 1), "%s: the host has %d textures, or new ones",
          when, kept);
    CHECK(glGetError() == GL_NO_ERROR, "%s: a GL error", when);
}

static void refused(const char *function, sbl_result result) {
    CHECK(result == SBL_ERROR_STATE && watch_said(&seen, SBL_LOG_ERROR, SBL_LOG_ITEM_NO_GL, function, "GLX",
          "glXMakeCurrent(display, None, NULL)"), "%s: %s, %s", function, sbl_result_string(result), watch_last(&seen));
    host_is_whole(function);
    watch_forget(&seen);
}

static sbl_result picture(sbl_context *context) {
    sbl_picture_desc view = scene_view(SIDE, SIDE, 90, 0, 1, 2, 0, 0, 0);
    view.options.mode = SBL_MODE_DIRECT;
    return sbl_render_picture(context, &view);
}

/* While the context of the host is current, sbl.h refuses all calls of headless contexts, and changes nothing. */
TEST(headless_beside_glx) {
    const sbl_context_desc desc = watch_desc(&seen);
    sbl_context *context = NULL, *other = NULL;
    float light[3 * SIDE * SIDE];
    sbl_scene_desc scene;
    test_scene room;
    memset(&room, 0, sizeof room);
    scene_box(&room, scene_lamp(&room, 1, 1, 1), -1, -1, -1, 1, 1, 1);
    scene = scene_desc(&room);
    refused("sbl_create", sbl_create(&desc, &context));
    CHECK(!context && !seen.blocks, "a refused context is left");
    host_is_current(0);
    REQUIRE(sbl_create(&desc, &context) == SBL_SUCCESS && sbl_set_scene(context, &scene) == SBL_SUCCESS, "%s",
            watch_last(&seen));
    CHECK(!glXGetCurrentContext(), "a context of GLX is current");
    REQUIRE(host_is_current(1), "the host's context cannot be made current");
    refused("sbl_set_scene", sbl_set_scene(context, &scene));
    refused("sbl_begin_picture", picture(context));
    refused("sbl_create", sbl_create(&desc, &other));
    sbl_destroy(context);
    refused("sbl_destroy", SBL_ERROR_STATE);
    host_is_current(0);
    CHECK(picture(context) == SBL_SUCCESS &&
          sbl_read_channel(context, SBL_CHANNEL_FINAL, light, 3 * SIDE * SIDE) == SBL_SUCCESS, "%s",
          watch_last(&seen));
    sbl_destroy(context);
    CHECK(!seen.blocks, "%d blocks are left", seen.blocks);
    REQUIRE(host_is_current(1), "the host's context cannot be made current");
    host_is_whole("afterwards");
    scene_free(&room);
}

static sbl_gl_function load(const char *name, void *user) {
    (void)user;
    return (sbl_gl_function)glXGetProcAddress((const GLubyte *)name);
}

/* With the function loader of the host, sbl.h works in the context of the host, which stays current. */
TEST(inside_glx) {
    sbl_context_desc desc = watch_desc(&seen);
    sbl_context *context = NULL;
    sbl_scene_desc scene;
    test_scene room;
    memset(&room, 0, sizeof room);
    scene_box(&room, scene_lamp(&room, 1, 1, 1), -1, -1, -1, 1, 1, 1);
    scene = scene_desc(&room);
    desc.get_gl_function = load;
    REQUIRE(sbl_create(&desc, &context) == SBL_SUCCESS && sbl_set_scene(context, &scene) == SBL_SUCCESS &&
            picture(context) == SBL_SUCCESS, "%s", watch_last(&seen));
    CHECK(glXGetCurrentContext() == host, "the host's context is not current");
    sbl_destroy(context);
    host_is_whole("afterwards");
    scene_free(&room);
}

int main(void) {
    if (!host_begin()) { printf("no GLX context\n"); return 1; }
    RUN(headless_beside_glx);
    RUN(inside_glx);
    return test_report();
}
