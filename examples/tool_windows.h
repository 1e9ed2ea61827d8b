/* Makes a picture or lightmap in windows: either the one window of --part K/N, or all windows of a result that is too
   large for memory. Finished windows are .exr files in the folder OUTPUT.parts, so that an interrupted run loses at
   most one. Include after tool_scene.h and tool_plan.h.

   A tool fills in a `windows`. windows_choose then divides the result into windows. If there are several, windows_make
   makes the unfinished ones. windows_join then joins them, or windows_open_parts lists them for a tool that joins them
   itself. windows_end removes the folder. */
#ifndef TOOL_WINDOWS_H
#define TOOL_WINDOWS_H

typedef struct windows {
    tool_task *task;
    progress *bar;
    const char *noun;             /* name of the result for messages, such as "picture" */
    const part_choice *part;      /* the part of --part; NULL: everything, or the window of --window */
    int by_hand, resume;          /* 1: --window was given; 1: --resume was given */
    int keeps_light;              /* 1: the folder stores the bounced light, because --store does not */
    const int *given;
    output_file *target;          /* the output file */
    int size[2], region[4];       /* size of the full result in pixels; region of the output: x, y, width, height */
    const char *const *channels;  /* names of the components in the files; see image.channels */
    int components;
    /* The functions of the tool, whose first argument is user. `bytes` returns the memory that a window needs. `look`
       makes a small version of the full result, and sets the mean, the price, the cells and the exposure in work.facts
       and, if cost is not NULL, the cost; it returns the exit status. `use` copies these facts into the descriptor of
       the windows. `make` makes a window, which `write` writes to an .exr file. */
    void *user;
    double (*bytes)(const void *user, const int window[4]);
    int (*look)(void *user, plan_cost *cost);
    void (*use)(void *user);
    sbl_result (*make)(void *user, const int window[4]);
    output_writer write;
    double plan_base;             /* PLAN_BASE_PICTURE or PLAN_BASE_LIGHTMAP */
    /* windows_choose sets the following */
    plan work;                    /* the windows to make one after the other; the tool sets its other facts before */
    plan_folder folder;           /* used if there are several windows */
    int has_facts;                /* 1: the output is a part, or is made in windows */
    int looked;                   /* 1: `look` was called, so the bounced light is known */
} windows;

/* Finishes the small version that `look` has begun. Sets the facts that come from it, except the exposure. If cost is
   not NULL, sets the cost, too. shrink: reduction factor of the small version */
static sbl_result windows_look(windows *w, double shrink, plan_cost *cost) {
    sbl_context *context = w->task->context;
    sbl_result result = work(context);
    const sbl_stats stats = sbl_query_stats(context);
    image spent = { 0 };
    clear_progress(w->bar);
    if (result != SBL_SUCCESS) return result;
    w->looked = 1;
    plan_set(&w->work, &stats, shrink);
    if (!cost) return result;
    result = picture_read(context, stats.picture.width, stats.picture.height, SBL_CHANNEL_WORK, &spent);
    if (result == SBL_SUCCESS && !plan_cost_make(cost, &spent, w->plan_base)) result = SBL_ERROR_OUT_OF_MEMORY;
    free(spent.values);
    return result;
}

/* Sets w->region to the window of --part K/N. The windows come from the file of --plan; if it does not exist, a small
   version shows their cost. Returns the exit status. */
static int windows__find_part(windows *w) {
    const int all[4] = { 0, 0, w->size[0], w->size[1] };
    plan_cost cost = { 0, 0, NULL };
    output_file file;
    const char *name = w->part->plan;
    int status = name ? plan_read(&w->work, name, w->size) : -1;
    if (status < 0) {
        status = w->look(w->user, &cost);
        if (status == DONE) status = plan_make(&w->work, cost.sums ? &cost : NULL, w->size, all, w->part->count);
        free(cost.sums);
        if (status == DONE && name) {
            output_find(&file, name);
            file.keep_existing = 1;  /* another machine may have written the plan meanwhile; then that plan is used */
            if (!target_write(&file, plan_write, &w->work, 0)) status = fail_to_write(name);
            output_free(&file);
            if (status == DONE) status = plan_read(&w->work, name, w->size);
        }
    }
    if (status != DONE) return status;
    if (w->work.count != w->part->count)
        return fail("--plan %s: it has %d parts, and --part asks for one of %d", name, w->work.count, w->part->count);
    memcpy(w->region, w->work.windows[w->part->number - 1], sizeof w->region);
    plan_fact(&w->work, FACT_PART, "%d/%d", w->part->number, w->part->count);
    return DONE;
}

/* Returns the number of bytes that --memory leaves for the result. */
static double windows__bytes_left(const windows *w) {
    const double allowed = (double)w->task->file->memory, least = fmin(allowed, 64.0 * (1 << 20));
    unsigned long pages = 0;
    FILE *in = fopen("/proc/self/statm", "r");
    if (in && fscanf(in, "%*u %lu", &pages) != 1) pages = 0;
    if (in) fclose(in);
    return fmax(least, allowed - (double)pages * (double)sysconf(_SC_PAGESIZE));
}

/* Divides the region into as few windows as the memory allows. Returns the exit status. */
static int windows__divide(windows *w) {
    enum { LARGEST = 1 << 24, SMALLEST = 1 << 14 };  /* pixels of a window: the greatest limits the loss of an
                                                        interrupted run; smaller ones than the smallest are not tried */
    const double left = windows__bytes_left(w), pixels = (double)w->region[2] * w->region[3];
    double count = ceil(pixels / LARGEST);
    int i, fits = 0, status = DONE;
    while (!fits && status == DONE) {
        status = plan_make(&w->work, NULL, w->size, w->region, (int)count);
        for (i = 0, fits = 1; i < w->work.count && fits && status == DONE; i++) {
            const int *one = w->work.windows[i];
            fits = (double)one[2] * one[3] <= SMALLEST || w->work.count == PARTS_MAX ||
                   (w->bytes(w->user, one) <= left && (double)one[2] * one[3] <= 1.5 * LARGEST);
        }
        count = fmin(ceil(1.2 * count + 0.5), fmin(PARTS_MAX, pixels));
    }
    return status;
}

static int windows__write(const char *name, output_writer write, const void *what) {
    output_file file;
    int ok = output_find(&file, name) && target_write(&file, write, what, 0);
    output_free(&file);
    return ok;
}

/* Opens the folder of finished windows, and creates it if it does not exist. If it holds the plan of an earlier run:
   with --resume, replaces w->work by that plan, loads its stored light if w->keeps_light is 1, and sets *found to 1,
   but fails if the plan is for another region; without --resume, fails. Otherwise sets *found to 0. Returns the exit
   status. */
static int windows__open_folder(windows *w, int *found) {
    plan old = w->work;
    FILE *light;
    int status;
    *found = 0;
    if (w->target->in_place)
        return fail("%s: a %s that is made window by window cannot go to a pipe or a device; give the name of a "
                    "file", common.output, w->noun);
    status = plan_folder_open(&w->folder, w->target->path);
    if (status != DONE) return status;
    old.windows = NULL;
    old.count = 0;
    status = plan_read(&old, plan_file(&w->folder, "plan"), w->size);
    if (status == DONE && w->resume && !plan_fills(&old, w->region))
        status = fail("%s has windows of another part; give each part an --output of its own", w->folder.path);
    if (status == DONE && w->resume) {
        plan_free(&w->work);
        w->work = old;
        *found = 1;
        light = w->keeps_light ? input_open(plan_file(&w->folder, "light")) : NULL;
        if (light) {
            sbl_load_store(w->task->context, get_bytes, light);  /* on failure, the light is computed again */
            fclose(light);
        }
        return DONE;
    }
    plan_free(&old);
    if (status == DONE)
        return fail("%s has finished windows of an earlier run: --resume goes on with it; remove the folder to start "
                    "again", w->folder.path);
    return status < 0 ? DONE : status;
}

static int windows__write_light(FILE *out, const void *what) {
    return sbl_save_store(((const windows *)what)->task->context, put_bytes, out) == SBL_SUCCESS;
}

/* Writes the light and then the plan into a new folder. The plan comes last, because its presence shows that the light
   is complete. Returns the exit status. */
static int windows__begin_folder(const windows *w) {
    const char *name = plan_file(&w->folder, "light");
    if (w->looked && w->keeps_light && !windows__write(name, windows__write_light, w)) return fail_to_write(name);
    name = plan_file(&w->folder, "plan");
    return windows__write(name, plan_write, &w->work) ? DONE : fail_to_write(name);
}

/* Decides which region is made and in which windows, and finds the facts that come from `look`. The other facts must be
   set before. Returns the exit status. */
static int windows_choose(windows *w) {
    int status = DONE, found = 0;
    if (w->part) {
        status = windows__find_part(w);
        if (status == DONE) w->use(w->user);  /* the number of cells decides how much memory the store needs */
    }
    if (status == DONE) status = windows__divide(w);
    if (status != DONE || (w->work.count == 1 && !w->part && !w->by_hand)) return status;
    if (w->work.count > 1) {
#ifndef SBL_RENDER_OPENEXR
        return fail("%d x %d pixels must be made window by window, which needs OpenEXR, and this program was built "
                    "without it; make at most 4096 x 4096 pixels, or give more --memory", w->region[2], w->region[3]);
#endif
        status = windows__open_folder(w, &found);
    }
    if (status == DONE && !w->part && !found) status = w->look(w->user, NULL);
    if (status == DONE && w->looked) status = keep_store(w->task, w->given);
    if (status == DONE && w->work.count > 1 && !found) status = windows__begin_folder(w);
    if (status == DONE) w->use(w->user);
    w->has_facts = status == DONE;
    return status;
}

/* Returns 1 if the file contains this window of this result completely. */
static int windows__is_finished(const windows *w, const char *name, const int window[4]) {
    static picture_parts one;
    float *band = NULL;
    int i, y, ok;
    one.frame.channels = w->channels;
    one.frame.components = w->components;
    ok = access(name, F_OK) == 0 && parts_add(&one, name);
    for (i = 0; i <= FACT_PART && ok; i++)
        ok = i == FACT_RENDERER || strcmp(one.list.facts[i].text, w->work.facts[i].text) == 0;
    ok = ok && memcmp(one.parts[0].at, window, sizeof one.parts[0].at) == 0 &&
         memcmp(one.parts[0].size, window + 2, sizeof one.parts[0].size) == 0;
    if (ok) band = (float *)malloc((size_t)window[2] * PARTS_BAND * (size_t)one.frame.components * sizeof *band);
    for (y = 0; y < window[3] && ok && band; y += PARTS_BAND)
        ok = parts_band(&one, window, window[1] + y, window[3] - y < PARTS_BAND ? window[3] - y : PARTS_BAND, band);
    ok = ok && band;
    free(band);
    parts_free(&one);
    return ok;
}

/* Returns the root mean square of two errors. fraction: that of the pixels that have the second error */
static float joint_error(float a, float b, double fraction) {
    return (float)sqrt((1 - fraction) * (double)a * (double)a + fraction * (double)b * (double)b);
}

/* Adds the statistics of a window to the sum over earlier windows. */
static void add_stats(sbl_stats *sum, const sbl_stats *s) {
    const double before = sum->picture.visible_pixels, own = s->picture.visible_pixels;
    const double fraction = before + own > 0 ? own / (before + own) : 1;
    const sbl_stats old = *sum;
    int i;
    *sum = *s;
    sum->sensors.sites += old.sensors.sites;
    sum->sensors.invalid += old.sensors.invalid;
    sum->sensors.views += old.sensors.views;
    sum->sensors.texels += old.sensors.texels;
    sum->sensors.rays += old.sensors.rays;
    sum->store.rays += old.store.rays;
    sum->picture.visible_pixels += old.picture.visible_pixels;
    sum->picture.expected_error = joint_error(old.picture.expected_error, s->picture.expected_error, fraction);
    sum->picture.radiance_error = joint_error(old.picture.radiance_error, s->picture.radiance_error, fraction);
    sum->picture.specular_error = joint_error(old.picture.specular_error, s->picture.specular_error, fraction);
    sum->picture.stored_error = joint_error(old.picture.stored_error, s->picture.stored_error, fraction);
    if (old.picture.level_count > s->picture.level_count) sum->picture.level_count = old.picture.level_count;
    for (i = 0; i < sum->picture.level_count; i++) sum->picture.levels[i].sensors += old.picture.levels[i].sensors;
    sum->seconds.surface += old.seconds.surface;
    sum->seconds.bounce += old.seconds.bounce;
    sum->seconds.gather += old.seconds.gather;
    sum->seconds.refine += old.seconds.refine;
    sum->seconds.filter += old.seconds.filter;
    sum->seconds.resolve += old.seconds.resolve;
    sum->seconds.total += old.seconds.total;
    sum->sensors.microseconds = sum->sensors.sites > 0 ? 1e6 * sum->seconds.total / (double)sum->sensors.sites : 0;
}

/* Makes the windows that are not finished yet. Returns the exit status. */
static int windows_make(windows *w) {
    const double from = w->bar->from, range = (w->bar->to > 0 ? w->bar->to : 1) - from;
    char name[PATH_MAX + 300];
    int i, written, finished = 0, status = DONE;
    for (i = 0; i < w->work.count && status == DONE; i++) {
        const int *one = w->work.windows[i];
        sbl_stats stats;
        sbl_result result;
        snprintf(name, sizeof name, "%s", plan_window_file(&w->folder, i));
        if (windows__is_finished(w, name, one)) { finished++; continue; }
        w->bar->from = from + range * i / w->work.count;
        w->bar->to = from + range * (i + 1.0) / w->work.count;
        result = w->make(w->user, one);
        written = result == SBL_SUCCESS && !interrupted && windows__write(name, w->write, w->user);
        if (result == SBL_UNFINISHED || (interrupted && !written))
            return stop("%d of %d windows are finished; --resume goes on with them (in %s)", finished, w->work.count,
                        w->folder.path);
        if (result != SBL_SUCCESS) return fail_with(w->task->said, common.scene, result);
        if (!written) return fail_to_write(name);
        finished++;
        status = keep_store(w->task, w->given);
        stats = sbl_query_stats(w->task->context);
        add_stats(&w->task->stats, &stats);
        detail("window %d of %d: %d,%d,%d,%d", i + 1, w->work.count, one[0], one[1], one[2], one[3]);
    }
    return status;
}

/* Lists the finished windows and checks that they cover the region. Returns 0 and sets parts->list.error if they do
   not. */
static int windows_open_parts(const windows *w, picture_parts *parts) {
    int i, ok = 1;
    parts->frame.channels = w->channels;
    parts->frame.components = w->components;
    for (i = 0; i < w->work.count && ok; i++) ok = parts_add(parts, plan_window_file(&w->folder, i));
    /* The facts of the windows of a part K/N all name part K/N. Here they are windows of one picture instead. */
    for (i = 0; i < parts->list.count; i++) parts->list.files[i].number = parts->list.files[i].count = 0;
    return ok && parts_check(parts, w->region);
}

/* Joins the finished windows into the output. Returns the exit status. facts, channel, stops: see parts_job */
static int windows_join(const windows *w, const picture_fact *facts, sbl_channel channel, double stops) {
    static picture_parts parts;
    parts_job job = { &parts, common.output, { 0, 0, 0, 0 }, facts, channel, stops, &interrupted };
    int status = DONE;
    memcpy(job.region, w->region, sizeof job.region);
    if (!windows_open_parts(w, &parts) || !target_write(w->target, parts_write, &job, 0))
        status = parts.list.error[0] ? fail("%s", parts.list.error)
               : interrupted ? stop("all windows are finished; --resume joins them (in %s)", w->folder.path)
                             : fail_to_write(common.output);
    parts_free(&parts);
    return status;
}

/* Sets the size in the statistics, which windows_make has added up, to the size of the output. */
static void windows_total(const windows *w) {
    w->task->has_stats = 1;
    w->task->stats.picture.width = w->region[2];
    w->task->stats.picture.height = w->region[3];
}

/* Removes the folder of finished windows. Must be called after the output was written. */
static inline void windows_end(windows *w) {
    windows_total(w);
    plan_folder_remove(&w->folder, w->work.count);
}

#endif
