/* For the host alone: nothing in the firmware calls it, so the linker leaves it out. */
#include "base/panic.h"
#include "speed/source.h"

const char *speed_source_name(speed_source_t source) {
    static const char *const names[] = {
#define SPEED_SOURCE(name, number, text, traits) [number] = text,
#include "speed/sources.def"
#undef SPEED_SOURCE
    };
    REQUIRE((unsigned)source < SPEED_SOURCE_COUNT);
    return names[source];
}
