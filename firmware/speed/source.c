#include "speed/source.h"

bool speed_source_is(speed_source_t source, speed_trait_t trait) {
    static const uint8_t traits_of[] = {
#define SPEED_SOURCE(name, number, text, traits) [number] = (traits),
#include "speed/sources.def"
#undef SPEED_SOURCE
    };
    return (unsigned)source < SPEED_SOURCE_COUNT && (traits_of[source] & trait) != 0;
}
