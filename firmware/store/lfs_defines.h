/* littlefs' settings: its assertions end where ours do. */
#ifndef STORE_LFS_DEFINES_H
#define STORE_LFS_DEFINES_H

#include "base/panic.h"

#define LFS_ASSERT(condition) REQUIRE(condition)

#endif
