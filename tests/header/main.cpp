/* One program of three files, part 3: a caller in C++, which must find the same functions and structs as the one in
   C. */
#include "../../sbl.h"
#include <stdio.h>
#include <string.h>

extern "C" const char *caller_version(void);
extern "C" size_t caller_desc_size(void);

int main() {
    char version[32];
    snprintf(version, sizeof version, "%d.%d.%d", SBL_VERSION_MAJOR, SBL_VERSION_MINOR, SBL_VERSION_PATCH);
    if (strcmp(version, sbl_version()) != 0)
        return printf("the macros say %s, sbl_version %s\n", version, sbl_version()), 1;
    if (caller_version() != sbl_version()) return printf("C and C++ call different functions\n"), 1;
    if (caller_desc_size() != sizeof(sbl_picture_desc) + sizeof(sbl_scene_desc) + sizeof(sbl_context_desc) +
        sizeof(sbl_stats))
        return printf("C and C++ have different sizes of structs\n"), 1;
    sbl_picture_desc desc = sbl_picture_desc_defaults(NULL);  // a struct returned by value, made in the other language
    desc.width = 7;
    if (sbl_picture_desc_defaults(&desc).width != 7) return printf("a struct is passed wrongly between C and C++\n"), 1;
    if (sbl_render_picture(NULL, &desc) != SBL_ERROR_INVALID_ARGUMENT)
        return printf("sbl_render accepts a NULL context\n"), 1;
    printf("%s\n", version);
    return 0;
}
