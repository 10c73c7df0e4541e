/* Which firmware this is. */
#ifndef LINK_BUILD_ID_H
#define LINK_BUILD_ID_H

/* git describe of the firmware, zero-terminated, at most 8 + 1 + 40 characters. */
const char *link_build_id(void);

#endif
