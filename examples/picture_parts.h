/* Joins the parts of a picture: reads .exr files that each contain a window of the picture, checks that they fit
   together, and writes the picture, or a region of it, in bands of rows. It holds only one band in memory, so the size
   of the picture does not matter. Include after picture_file.h and part_list.h. Without OpenEXR (SBL_RENDER_OPENEXR),
   every part is refused.

       picture_parts parts = { 0 };
       for (...) ok = ok && parts_add(&parts, name);
       ok = ok && parts_check(&parts, region);        // parts.list.error says what is wrong
       ok = ok && target_write(&target, parts_write, &job, 0);
       parts_free(&parts); */
#ifndef PICTURE_PARTS_H
#define PICTURE_PARTS_H

/* The facts (picture_fact) that a part contains. All except the last two must be the same in all parts. */
enum {
    FACT_VERSION,   /* the version of sbl.h */
    FACT_SCENE,     /* hash of meshes, materials, lights and sky, from sbl_scene_fingerprint */
    FACT_CAMERA,    /* hash of the matrices of the camera */
    FACT_OPTIONS,   /* the options that change the picture, as the user gave them */
    FACT_CHANNEL,
    FACT_SIZE,      /* size of the full picture */
    FACT_MEAN,      /* means of the full picture, which errors are relative to: mean_radiance and mean_final of
                       sbl_picture_desc */
    FACT_PRICE,     /* price, specular_price and look_rays of sbl_picture_desc */
    FACT_CELLS,     /* max_bounce_cells of sbl_picture_desc; 0 if there is no store */
    FACT_EXPOSURE,  /* in stops; 0 if the channel has no exposure */
    FACT_RENDERER,  /* GL_RENDERER */
    FACT_PART,      /* the number of this part, such as "3/16", or empty */
    FACT_COUNT
};

static const char *const fact_names[FACT_COUNT] = { "sbl.version", "sbl.scene", "sbl.camera", "sbl.options",
    "sbl.channel", "sbl.size", "sbl.mean", "sbl.price", "sbl.cells", "sbl.exposure", "sbl.renderer", "sbl.part" };

/* For each fact, the words of an error message about a difference, which follow "it was made". */
static const char *const fact_words[FACT_COUNT] = { "by another version of sbl.h",
    "from another scene, or with other materials, lights or texture coordinates", "with another camera",
    "with other options", "of another channel", "for another size",
    "with another plan (give all parts the same --plan)", "with another plan (give all parts the same --plan)",
    "with another plan (give all parts the same --plan)", "with another plan (give all parts the same --plan)",
    "by another driver", "as another part" };

/* An option such as --sky also changes the scene, and --size the camera. */
static const int fact_order[] = { FACT_VERSION, FACT_OPTIONS, FACT_CHANNEL, FACT_SIZE, FACT_SCENE, FACT_CAMERA,
    FACT_MEAN, FACT_PRICE, FACT_CELLS, FACT_EXPOSURE, -1 };
enum { FACTS_OF_RUN = 6 };  /* the first of fact_order, which a run knows before it renders anything */

static const part_kind picture_kind = { fact_names, fact_words, fact_order, 1u << FACT_SCENE | 1u << FACT_CAMERA,
    FACT_RENDERER };

/* A part: the window of the picture that its file contains. */
typedef struct picture_part {
    int at[2], size[2];   /* first pixel, as a position in the full picture; size in pixels */
#ifdef SBL_RENDER_OPENEXR
    exr_context_t exr;    /* NULL while the file is closed */
#endif
    unsigned used;        /* value of picture_parts.turn when rows were last read */
} picture_part;

enum { PARTS_OPEN = 64, PARTS_BAND = 64 };  /* maximum number of open files; rows of a band */
enum { PARTS_ACROSS = 16384 };              /* maximum width and height of the full picture */

typedef struct picture_parts {
    part_list list;
    picture_part *parts;                 /* one for each file in list */
    int room;
    image frame;                         /* the size of the full picture, its components and its facts */
    int open;                            /* number of open files */
    unsigned turn;
} picture_parts;

/* Returns the file name of a part. */
static inline const char *parts__name(const picture_parts *p, const picture_part *part) {
    return p->list.files[part - p->parts].name;
}

#ifdef SBL_RENDER_OPENEXR

static void parts__close(picture_parts *p, picture_part *part) {
    if (!part->exr) return;
    exr_finish(&part->exr);
    part->exr = NULL;
    p->open--;
}

/* Opens the file of a part. If too many files are open, closes the least recently used one first. Returns 0 and sets
   p->list.error on failure. */
static int parts__open(picture_parts *p, picture_part *part) {
    exr_context_initializer_t settings = EXR_DEFAULT_CONTEXT_INITIALIZER;
    const char *name = parts__name(p, part);
    picture_part *oldest = NULL;
    struct stat info;
    int i;
    part->used = ++p->turn;
    if (part->exr) return 1;
    for (i = 0; i < p->list.count && p->open == PARTS_OPEN; i++)
        if (p->parts[i].exr && (!oldest || p->parts[i].used < oldest->used)) oldest = &p->parts[i];
    if (oldest) parts__close(p, oldest);
    if (stat(name, &info) != 0) return parts__fail(&p->list, "%s: %s", name, strerror(errno));
    if (!S_ISREG(info.st_mode)) return parts__fail(&p->list, "%s: not a regular file", name);
    settings.error_handler_fn = on_exr_error;
    if (exr_start_read(&part->exr, name, &settings) == EXR_ERR_SUCCESS) {
        p->open++;
        return 1;
    }
    part->exr = NULL;
    return parts__fail(&p->list, "%s: not a complete .exr file; if it is a part, make it again", name);
}

/* Reads a fact of an open part. A fact that the file lacks becomes "". */
static void parts__fact(const picture_part *part, int fact, char *out) {
    const char *text = NULL;
    int32_t length = 0;
    out[0] = 0;
    if (exr_attr_get_string(part->exr, 0, fact_names[fact], &length, &text) == EXR_ERR_SUCCESS && text)
        snprintf(out, PICTURE_FACT_SIZE, "%s", text);
}

/* Returns the number of components of a file, or 0 if it does not fit. It must have a single part of scanlines, with
   32-bit floats in the channels of p->frame, or in Y or R, G and B if p->frame.channels is NULL. */
static int parts__components(const picture_parts *p, const picture_part *part) {
    const exr_attr_chlist_t *list = NULL;
    image frame = p->frame;
    exr_storage_t storage;
    int count = 0, i;
    if (exr_get_count(part->exr, &count) != EXR_ERR_SUCCESS || count != 1) return 0;
    if (exr_get_storage(part->exr, 0, &storage) != EXR_ERR_SUCCESS || storage != EXR_STORAGE_SCANLINE) return 0;
    if (exr_get_channels(part->exr, 0, &list) != EXR_ERR_SUCCESS || !list) return 0;
    if (frame.channels ? list->num_channels != frame.components : list->num_channels != 1 && list->num_channels != 3)
        return 0;
    frame.components = list->num_channels;
    for (i = 0; i < list->num_channels; i++) {
        const exr_attr_chlist_entry_t *c = &list->entries[i];
        if (picture__component(&frame, c->name.str) < 0 || c->pixel_type != EXR_PIXEL_FLOAT || c->x_sampling != 1 ||
            c->y_sampling != 1) return 0;
    }
    return list->num_channels;
}

/* Returns 0 and sets p->list.error if a part of a lightmap is read as a picture, or if it has other channels than the
   lightmap. components: result of parts__components */
static int parts__is_kind(picture_parts *p, const picture_part *part, int components) {
    char channel[PICTURE_FACT_SIZE], options[PICTURE_FACT_SIZE];
    parts__fact(part, FACT_CHANNEL, channel);
    parts__fact(part, FACT_OPTIONS, options);
    if (strcmp(channel, "lightmap") != 0) return 1;
    if (!p->frame.channels)
        return parts__fail(&p->list, "%s: it is a part of a lightmap, whose gutters and seams need the scene; sbl_bake "
                           "--lightmap with --join joins the parts", parts__name(p, part));
    return components || parts__fail(&p->list, "%s does not fit: it was made with other options: it has %s; with "
                                     "--directional or --light-groups, a part has other channels",
                                     parts__name(p, part), fact_shown(options));
}

/* Reads the header of a part and checks it against the first part, which sets p->frame and p->list.facts. Returns 0 and
   sets p->list.error if it does not fit. */
static int parts__header(picture_parts *p, picture_part *part) {
    static picture_fact facts[PICTURE_FACTS];
    exr_attr_box2i_t data, display;
    int i, components;
    if (!parts__open(p, part)) return 0;
    components = parts__components(p, part);
    parts__fact(part, FACT_VERSION, facts[FACT_VERSION].text);
    if (!parts__is_kind(p, part, components)) return 0;
    if (!components || !facts[FACT_VERSION].text[0] || exr_get_data_window(part->exr, 0, &data) != EXR_ERR_SUCCESS ||
        exr_get_display_window(part->exr, 0, &display) != EXR_ERR_SUCCESS)
        return parts__fail(&p->list, "%s: not a part made by %s", parts__name(p, part),
                           p->frame.channels ? "sbl_bake --lightmap --part" : "sbl_render --part or --window");
    part->at[0] = data.min.x;
    part->at[1] = data.min.y;
    part->size[0] = data.max.x - data.min.x + 1;
    part->size[1] = data.max.y - data.min.y + 1;
    for (i = 0; i < FACT_COUNT; i++) {
        facts[i].name = fact_names[i];
        parts__fact(part, i, facts[i].text);
    }
    if (!parts__number(&p->list, facts[FACT_PART].text)) return 0;
    if (p->list.count == 1) {
        p->frame.width = display.max.x + 1;
        p->frame.height = display.max.y + 1;
        p->frame.components = components;
        p->frame.facts = p->list.facts;
    }
    if (!parts__fit(&p->list, &picture_kind, facts)) return 0;
    if (p->frame.width > PARTS_ACROSS || p->frame.height > PARTS_ACROSS)
        return parts__fail(&p->list, "%s: it is damaged: it is a part of a picture of %d x %d pixels, more than "
                           "%d x %d; make this part again", parts__name(p, part), p->frame.width, p->frame.height,
                           PARTS_ACROSS, PARTS_ACROSS);
    if (components != p->frame.components || display.max.x + 1 != p->frame.width ||
        display.max.y + 1 != p->frame.height)
        return parts__fail(&p->list, "%s does not fit %s: it belongs to another picture", parts__name(p, part),
                           p->list.files[0].name);
    if (part->at[0] < 0 || part->at[1] < 0 || part->size[0] < 1 || part->size[1] < 1 ||
        part->at[0] + part->size[0] > p->frame.width || part->at[1] + part->size[1] > p->frame.height)
        return parts__fail(&p->list, "%s: its window is not inside the picture", parts__name(p, part));
    return 1;
}

/* Decodes the chunk that contains row y of the full picture. Returns 0 on failure. rows: receives the rows of the
   chunk; span: receives the first row and the number of rows. decoder: all bytes must be 0 before the first chunk */
static int parts__decode(const image *frame, const picture_part *part, int y, float *rows,
                         exr_decode_pipeline_t *decoder, int span[2]) {
    const int n = frame->components, begun = decoder->channels != NULL;
    exr_chunk_info_t chunk = { 0 };
    exr_result_t result = exr_read_scanline_chunk_info(part->exr, 0, y, &chunk);
    int k;
    if (result == EXR_ERR_SUCCESS)
        result = begun ? exr_decoding_update(part->exr, 0, &chunk, decoder)
                       : exr_decoding_initialize(part->exr, 0, &chunk, decoder);
    for (k = 0; k < n && result == EXR_ERR_SUCCESS; k++) {
        exr_coding_channel_info_t *channel = &decoder->channels[k];
        const int component = picture__component(frame, channel->channel_name);
        channel->decode_to_ptr = (uint8_t *)(rows + component);
        channel->user_bytes_per_element = 4;
        channel->user_data_type = EXR_PIXEL_FLOAT;
        channel->user_pixel_stride = 4 * n;
        channel->user_line_stride = 4 * n * part->size[0];
    }
    if (result == EXR_ERR_SUCCESS && !begun)
        result = exr_decoding_choose_default_routines(part->exr, 0, decoder);
    if (result == EXR_ERR_SUCCESS) result = exr_decoding_run(part->exr, 0, decoder);
    span[0] = chunk.start_y;
    span[1] = chunk.height;
    return result == EXR_ERR_SUCCESS;
}

/* Copies the pixels of a part in the rows from y to y + rows - 1 of the full picture to a band of the region. Returns 0
   and sets p->list.error on failure. */
static int parts__copy(picture_parts *p, picture_part *part, const int region[4], int y, int rows, float *band) {
    const size_t n = (size_t)p->frame.components;
    const int last = part->at[1] + part->size[1] < y + rows ? part->at[1] + part->size[1] : y + rows;
    const int left = part->at[0] > region[0] ? part->at[0] : region[0];
    const int ends = part->at[0] + part->size[0] < region[0] + region[2] ? part->at[0] + part->size[0]
                                                                         : region[0] + region[2];
    exr_decode_pipeline_t decoder;
    int32_t step = 1;
    int at = part->at[1] > y ? part->at[1] : y, span[2] = { 0, 0 }, ok = 1, row;
    float *chunk;
    if (left >= ends || at >= last) return 1;
    if (!parts__open(p, part)) return 0;
    if (exr_get_scanlines_per_chunk(part->exr, 0, &step) != EXR_ERR_SUCCESS || step < 1) step = 1;
    chunk = (float *)malloc((size_t)step * (size_t)part->size[0] * n * sizeof *chunk);
    if (!chunk) return parts__fail(&p->list, "out of memory");
    memset(&decoder, 0, sizeof decoder);
    while (at < last && ok) {
        ok = parts__decode(&p->frame, part, at, chunk, &decoder, span);
        for (row = at; ok && row < span[0] + span[1] && row < last; row++)
            memcpy(band + ((size_t)(row - y) * (size_t)region[2] + (size_t)(left - region[0])) * n,
                   chunk + ((size_t)(row - span[0]) * (size_t)part->size[0] + (size_t)(left - part->at[0])) * n,
                   (size_t)(ends - left) * n * sizeof *band);
        at = span[0] + span[1];
    }
    exr_decoding_destroy(part->exr, &decoder);
    free(chunk);
    return ok || parts__fail(&p->list, "%s: it is damaged or incomplete; make this part again", parts__name(p, part));
}

#else

static void parts__close(picture_parts *p, picture_part *part) { (void)p; (void)part; }

static int parts__header(picture_parts *p, picture_part *part) {
    return parts__fail(&p->list, "%s: this program was built without OpenEXR, which parts need", parts__name(p, part));
}

static int parts__copy(picture_parts *p, picture_part *part, const int region[4], int y, int rows, float *band) {
    (void)region; (void)y; (void)rows; (void)band;
    return parts__header(p, part);
}

#endif

/* Adds a file. Returns 0 and sets p->list.error if it is not a part, or does not fit the parts added before. */
static inline int parts_add(picture_parts *p, const char *name) {
    picture_part *part;
    if (!parts__list(&p->list, name)) return 0;
    if (p->room < p->list.room) {
        picture_part *more = (picture_part *)realloc(p->parts, (size_t)p->list.room * sizeof *more);
        if (!more) return parts__fail(&p->list, "out of memory");
        p->parts = more;
        p->room = p->list.room;
    }
    part = &p->parts[p->list.count - 1];
    memset(part, 0, sizeof *part);
    return parts__header(p, part);
}

static inline void parts_free(picture_parts *p) {
    int i;
    for (i = 0; i < p->list.count && i < p->room; i++) parts__close(p, &p->parts[i]);
    free(p->parts);
    parts__list_free(&p->list);
    memset(p, 0, sizeof *p);
}

static int parts__overlap(const picture_part *a, const picture_part *b) {
    return a->at[0] < b->at[0] + b->size[0] && b->at[0] < a->at[0] + a->size[0] &&
           a->at[1] < b->at[1] + b->size[1] && b->at[1] < a->at[1] + a->size[1];
}

/* Returns 1 if the parts cover each pixel of the region (x, y, width, height) exactly once. Otherwise sets
   p->list.error. */
static inline int parts_check(picture_parts *p, const int region[4]) {
    double pixels = 0;
    int i, k;
    if (!p->list.count) return parts__fail(&p->list, "no parts are given");
    if (!parts__check_numbers(&p->list)) return 0;
    for (i = 0; i < p->list.count; i++) {
        const picture_part *part = &p->parts[i];
        if (part->at[0] < region[0] || part->at[1] < region[1] || part->at[0] + part->size[0] > region[0] + region[2] ||
            part->at[1] + part->size[1] > region[1] + region[3])
            return parts__fail(&p->list, "%s: it belongs to another part of the picture", parts__name(p, part));
        pixels += (double)part->size[0] * part->size[1];
        for (k = 0; k < i; k++)
            if (parts__overlap(&p->parts[i], &p->parts[k]))
                return parts__fail(&p->list, "%s and %s overlap%s", p->list.files[k].name, p->list.files[i].name,
                                   p->list.files[i].count ? "; give all parts the same --plan" : "");
    }
    if (pixels < (double)region[2] * region[3])
        return parts__fail(&p->list, "%.0f of %.0f pixels are in no part%s", (double)region[2] * region[3] - pixels,
                           (double)region[2] * region[3],
                           p->list.files[0].count ? "; give all parts the same --plan" : "");
    return 1;
}

/* Reads the rows from y to y + rows - 1 of the full picture, within the region, from all parts. */
static inline int parts_band(picture_parts *p, const int region[4], int y, int rows, float *band) {
    int i, ok = 1;
    for (i = 0; i < p->list.count && ok; i++) ok = parts__copy(p, &p->parts[i], region, y, rows, band);
    return ok;
}

/* Arguments of parts_write: a region of the full picture, and a file name whose ending selects the format. */
typedef struct parts_job {
    picture_parts *parts;
    const char *name;
    int region[4];
    const picture_fact *facts;              /* the facts that the file gets; see image.facts */
    sbl_channel channel;
    double stops;
    const volatile sig_atomic_t *cancel;
} parts_job;

/* Reads the band with the index `number` of the region. Returns 0 on failure or cancellation. rows: receives its number
   of rows */
static int parts__read_band(const parts_job *job, int number, float *band, int *rows) {
    const int first = number * PARTS_BAND, left = job->region[3] - first;
    *rows = left < PARTS_BAND ? left : PARTS_BAND;
    return !*job->cancel && parts_band(job->parts, job->region, job->region[1] + first, *rows, band);
}

/* Writes a region in bands, for target_write. Returns 0 on failure. what: a parts_job */
static inline int parts_write(FILE *out, const void *what) {
    const parts_job *job = (const parts_job *)what;
    const int bands = (job->region[3] + PARTS_BAND - 1) / PARTS_BAND, n = job->parts->frame.components;
    const int measures = job->channel == SBL_CHANNEL_POSITION || job->channel == SBL_CHANNEL_DEPTH ||
                         job->channel == SBL_CHANNEL_SENSORS;
    const size_t width = (size_t)job->region[2];
    float *band = (float *)malloc(PARTS_BAND * width * (size_t)n * sizeof *band);
    image frame = job->parts->frame;
    picture_writer w;
    int i, rows, ok;
    frame.width = job->region[2];
    frame.height = job->region[3];
    frame.facts = job->facts;
    if (job->region[2] < job->parts->frame.width || job->region[3] < job->parts->frame.height) {
        memcpy(frame.at, job->region, sizeof frame.at);
        frame.full[0] = job->parts->frame.width;
        frame.full[1] = job->parts->frame.height;
    }
    ok = picture_begin(&w, out, job->name, &frame, job->channel, job->stops) && band;
    for (i = 0; i < bands && ok && measures && w.format == PICTURE_PNG; i++) {
        ok = parts__read_band(job, i, band, &rows);
        if (ok) picture_extend(&w.range, band, (size_t)rows * width, n);
    }
    for (i = 0; i < bands && ok; i++) {
        const int number = w.format == PICTURE_PFM ? bands - 1 - i : i;
        ok = parts__read_band(job, number, band, &rows) && picture_put(&w, number * PARTS_BAND, rows, band) &&
             !ferror(out);
    }
    free(band);
    return picture_end(&w, ok);
}

#endif
