/*
 * The one place where the generated headers' parser and packer are compiled. Everybody else sees
 * their prototypes only (MAVLINK_SEPARATE_HELPERS): without this each file that includes the
 * headers gets its own copy.
 */
#include "tailbeat/mavlink.h"

#include "mavlink_helpers.h"
