/* The keys and the mouse of sbl_view. sbl_view.c includes this file after its state. */
#ifndef VIEW_INPUT_H
#define VIEW_INPUT_H

static camera_view first_camera;

/* Returns a length that represents the size of the scene. */
static double view_reach(void) { return survey__radius(&view.seen) > 0 ? survey__radius(&view.seen) : 1; }

static int is_held(int key) { return glfwGetKey(view.window, key) == GLFW_PRESS; }

/* Finds the pixel at a point of the window. size: of the picture that the window shows */
static void pixel_at(const double mouse[2], const int size[2], int out[2]) {
    int window[2], k;
    glfwGetWindowSize(view.window, &window[0], &window[1]);
    for (k = 0; k < 2; k++) {
        out[k] = window[k] > 0 ? (int)floor(mouse[k] * size[k] / window[k]) : 0;
        out[k] = out[k] < 0 ? 0 : out[k] >= size[k] ? size[k] - 1 : out[k];
    }
}

/* ---- moving lights ---- */

/* Moves the selected light by a number of pixels to the right and up, and away from the camera by a fraction of the
   distance. */
static void move_light(double right, double up, double away) {
    const view_axes a = view_axes_of(&view.camera);
    sbl_light *light = &view.lights[view.light];
    double at[3], depth, pixel;
    int k;
    light_place(light, at);
    depth = fabs(view_depth(&view.camera, at));
    pixel = view_pixel(&view.camera, depth);
    for (k = 0; k < 3; k++)
        at[k] += pixel * (right * a.right[k] + up * a.up[k]) + away * depth * a.forward[k];
    for (k = 0; k < 3; k++) {
        if (light->kind == SBL_LIGHT_DIRECTIONAL) light->direction[k] = (float)(survey__center(&view.seen, k) - at[k]);
        else light->position[k] = (float)at[k];
    }
    view.lights_moved = 1;
    change();
}

static void scale_light(float factor) {
    int k;
    if (view.light < 0) return;
    for (k = 0; k < 3; k++) view.lights[view.light].intensity[k] *= factor;
    view.lights_moved = 1;
    change();
}

static void select_light(void) {
    view.light = view.light + 1 < view.light_count ? view.light + 1 : -1;
    if (!view.light_count) tell("the scene has no lights that can be moved; surfaces that emit stay where they are");
    view.redraw = 1;
}

/* Returns 1 if a point of the window is on the mark of the selected light. */
static int is_on_light(const double mouse[2]) {
    float clip[4];
    double at[3];
    int window[2];
    if (view.light < 0) return 0;
    light_place(&view.lights[view.light], at);
    view_project(overlay.world_to_view, overlay.view_to_clip, at, clip);
    glfwGetWindowSize(view.window, &window[0], &window[1]);
    return clip[3] > 0 && fabs(((double)clip[0] / (double)clip[3] + 1) / 2 * window[0] - mouse[0]) < 1.5 * VIEW_MARK &&
        fabs((1 - (double)clip[1] / (double)clip[3]) / 2 * window[1] - mouse[1]) < 1.5 * VIEW_MARK;
}

/* ---- the mouse ---- */

/* Finds the point that a drag rotates the camera about: the surface under the mouse, or else a point in front of the
   camera. */
static void find_pivot(const double mouse[2]) {
    const view_axes a = view_axes_of(&view.camera);
    const size_t pixels = (size_t)view.work_size[0] * (size_t)view.work_size[1];
    float *places = (float *)malloc(3 * pixels * sizeof *places);
    double center[3], depth;
    int pixel[2], k, found = 0;
    for (k = 0; k < 3; k++) center[k] = survey__center(&view.seen, k);
    depth = view_depth(&view.camera, center);
    if (!(depth > 0)) depth = view_reach();
    for (k = 0; k < 3; k++) view.pivot[k] = view.camera.eye[k] + depth * a.forward[k];
    pixel_at(mouse, view.work_size, pixel);
    if (places && !view.dirty && view.stage != NOTHING &&
        sbl_read_channel(view.context, SBL_CHANNEL_POSITION, places, 3 * pixels) == SBL_SUCCESS) {
        const float *p = places + 3 * ((size_t)pixel[1] * (size_t)view.work_size[0] + (size_t)pixel[0]);
        for (k = 0; k < 3; k++) found = found || p[k] < 0 || p[k] > 0;
        for (k = 0; k < 3 && found; k++) view.pivot[k] = (double)p[k];
    }
    free(places);
}

/* Handles a mouse button. The position is that of the last mouse movement, because the mouse may have moved on since
   the button was pressed. */
static void on_button(GLFWwindow *window, int button, int action, int modifiers) {
    (void)window;
    (void)modifiers;
    if (action == GLFW_PRESS && view.button < 0) {
        view.button = button;
        view.dragged = 0;
        view.on_light = button == GLFW_MOUSE_BUTTON_LEFT && is_on_light(view.mouse);
        memcpy(view.pressed, view.mouse, sizeof view.pressed);
        if (button == GLFW_MOUSE_BUTTON_LEFT && !view.on_light) find_pivot(view.mouse);
    }
    if (action != GLFW_RELEASE || button != view.button) return;
    view.button = -1;
    if (button != GLFW_MOUSE_BUTTON_LEFT || view.dragged || view.on_light) return;
    view.clicked = 1;
    pixel_at(view.mouse, view.size, view.click);  /* only the final picture is inspected, even if a preview is shown */
}

/* Handles a drag. x, y: how far the mouse has moved */
static void drag(double x, double y) {
    const double angle = 2 * atan(1.0) * 4 / (view.size[0] + view.size[1] > 0 ? view.size[0] + view.size[1] : 1);
    const double length = view_pixel(&view.camera, fmax(view_depth(&view.camera, view.pivot), 0.05 * view_reach()));
    if (view.on_light) { move_light(x, -y, 0); return; }
    if (view.button == GLFW_MOUSE_BUTTON_LEFT) view_orbit(&view.camera, view.pivot, -angle * x, -angle * y);
    else if (view.button == GLFW_MOUSE_BUTTON_RIGHT)
        view_orbit(&view.camera, view.camera.eye, -0.5 * angle * x, -0.5 * angle * y);
    else view_move(&view.camera, -x * length, y * length, 0);
    change();
}

static void on_mouse(GLFWwindow *window, double x, double y) {
    const double dx = x - view.mouse[0], dy = y - view.mouse[1];
    (void)window;
    if (view.button >= 0 && !view.dragged && fabs(x - view.pressed[0]) + fabs(y - view.pressed[1]) < VIEW_CLICK) return;
    view.mouse[0] = x;
    view.mouse[1] = y;
    if (view.button < 0) return;
    view.dragged = 1;
    drag(dx, dy);
}

static void on_wheel(GLFWwindow *window, double x, double y) {
    (void)window;
    (void)x;
    view_move(&view.camera, 0, 0, 0.1 * y * view_reach());
    change();
}

/* ---- keys ---- */

static void set_channel(int channel) {
    view.channel = (channel + CHANNELS) % CHANNELS;
    view.redraw = 1;
    view.titled = 0;
}

static void set_exposure(double stops) {
    view.exposure = stops;
    view.redraw = 1;
    view.titled = 0;
    if (isnan(stops) && isnan(view.metered)) change();
}

static void print_camera(void) {
    char words[256];
    camera_words(words, sizeof words, &view.camera, &view.seen);
    printf("%s --size %dx%d\n", words, view.size[0], view.size[1]);
    fflush(stdout);
}

/* Moves the selected light by a key. Returns 0 if the key does not move lights. */
static int light_key(int key) {
    const double right = (key == GLFW_KEY_RIGHT) - (key == GLFW_KEY_LEFT), up = (key == GLFW_KEY_UP) -
        (key == GLFW_KEY_DOWN), away = (key == GLFW_KEY_PAGE_UP) - (key == GLFW_KEY_PAGE_DOWN);
    const double step = view.size[1] / 20.0;
    if (view.light < 0 || (right == 0.0 && up == 0.0 && away == 0.0)) return 0;
    move_light(step * right, step * up, 0.05 * away);
    return 1;
}

static void on_key(GLFWwindow *window, int key, int code, int action, int modifiers) {
    (void)code;
    (void)modifiers;
    if (action == GLFW_RELEASE || light_key(key) || action == GLFW_REPEAT) return;
    switch (key) {
        case GLFW_KEY_ESCAPE: glfwSetWindowShouldClose(window, 1); break;
        case GLFW_KEY_HOME: view.camera = first_camera; change(); break;
        case GLFW_KEY_BACKSPACE: overlay.has_sensor = view.clicked = 0; view.redraw = 1; break;
        case GLFW_KEY_KP_ADD: set_exposure(shown_exposure() + 0.25); break;
        case GLFW_KEY_KP_SUBTRACT: set_exposure(shown_exposure() - 0.25); break;
        default: break;
    }
}

/* Handles keys by the character on them, so that the layout of the keyboard does not matter. */
static void on_character(GLFWwindow *window, unsigned character) {
    (void)window;
    if (view.button == GLFW_MOUSE_BUTTON_RIGHT) return;  /* while this button is held, the keys move the camera */
    if (character >= '0' && character <= '9') set_channel(character == '0' ? 9 : (int)(character - '1'));
    switch (character) {
        case '[': set_channel(view.channel - 1); break;
        case ']': set_channel(view.channel + 1); break;
        case '+': case '=': set_exposure(shown_exposure() + 0.25); break;
        case '-': set_exposure(shown_exposure() - 0.25); break;
        case 'x': case 'X': set_exposure(NAN); break;
        case 't': case 'T': view.tone = (view.tone + 1) % TONES; view.redraw = 1; view.titled = 0; break;
        case 'm': case 'M':
            view.mode = view.mode == SBL_MODE_DIRECT ? SBL_MODE_GI : SBL_MODE_DIRECT;
            change();
            break;
        case 'l': case 'L': select_light(); break;
        case ',': scale_light(0.5f); break;
        case '.': scale_light(2); break;
        case 'r': case 'R': change(); break;
        case 'c': case 'C': print_camera(); break;
        case 's': case 'S':
            if (!finished()) tell("the picture is saved when it is finished");
            view.saves = 1;
            break;
        case 'h': case 'H': case '?': tool_print_text(keys); fflush(stdout); break;
        default: break;
    }
}

/* Moves the camera according to the keys that are held. */
static void fly(void) {
    static double last;
    const double time = now(), passed = last > 0 ? fmin(time - last, 0.1) : 0;
    const int letters = view.button == GLFW_MOUSE_BUTTON_RIGHT, arrows = view.light < 0;
    const double length = 0.35 * view_reach() * passed * (is_held(GLFW_KEY_LEFT_SHIFT) ? 4 : 1);
    int right = 0, up = 0, forward = 0;
    last = time;
    if (letters) {
        right += is_held(GLFW_KEY_D) - is_held(GLFW_KEY_A);
        up += is_held(GLFW_KEY_E) - is_held(GLFW_KEY_Q);
        forward += is_held(GLFW_KEY_W) - is_held(GLFW_KEY_S);
    }
    if (arrows) {
        right += is_held(GLFW_KEY_RIGHT) - is_held(GLFW_KEY_LEFT);
        up += is_held(GLFW_KEY_PAGE_UP) - is_held(GLFW_KEY_PAGE_DOWN);
        forward += is_held(GLFW_KEY_UP) - is_held(GLFW_KEY_DOWN);
    }
    if (!right && !up && !forward) return;
    view_move(&view.camera, right * length, up * length, forward * length);
    change();
}

/* ---- the window ---- */

/* Handles a new size of the window. A minimised window has no size; its picture stays. */
static void on_size(GLFWwindow *window, int width, int height) {
    (void)window;
    if (width < 1 || height < 1 || (width == view.size[0] && height == view.size[1])) return;
    view.size[0] = width;
    view.size[1] = height;
    if (view.context) change();
    view.redraw = 1;
}

static void on_refresh(GLFWwindow *window) { (void)window; view.redraw = 1; }

#endif
