/* One program of three files, part 2: a caller in C that includes the header twice. */
#include "../../sbl.h"
#include "../../sbl.h"

const char *caller_version(void);
size_t caller_desc_size(void);

const char *caller_version(void) { return sbl_version(); }
size_t caller_desc_size(void) {
    return sizeof(sbl_picture_desc) + sizeof(sbl_scene_desc) + sizeof(sbl_context_desc) + sizeof(sbl_stats);
}
