#include "link/build_id.h"
#include "build_id_generated.h"
#include "store/records.h"

_Static_assert(sizeof TAILBEAT_BUILD_ID <= BUILD_ID_BYTES, "fits into its files");

/* By it the host finds the id in the flash image (host/tailbeat/flashing/image.py). */
#define MARKER "tailbeat build id: "

static const char marked_id[] = MARKER TAILBEAT_BUILD_ID;

const char *link_build_id(void) { return &marked_id[sizeof MARKER - 1u]; }
