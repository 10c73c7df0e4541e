#include "link/received.h"

bool received_is_ours(uint8_t system, uint8_t component) {
    return (system == LINK_SYSTEM || system == 0) &&
           (component == LINK_COMPONENT || component == 0);
}

bool received_is_ours_alone(uint8_t system, uint8_t component) {
    return system == LINK_SYSTEM && received_is_ours(system, component);
}
