/* The reader of scene files as one object, which all tools share; see scripts/Makefile. */
#define _DEFAULT_SOURCE
#define SCENE_FILE_API
#include "../../sbl.h"
#include "../../examples/scene_file.h"
