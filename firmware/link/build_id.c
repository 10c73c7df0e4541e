#include "build_id_generated.h"
#include "link/link.h"

_Static_assert(sizeof TAILBEAT_BUILD_ID <= 50, "fits into the trial file's header");

const char *link_build_id(void) { return TAILBEAT_BUILD_ID; }
