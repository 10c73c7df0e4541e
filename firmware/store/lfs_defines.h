/*
 * littlefs' settings: its assertions end where ours do. They are 61, and all name the same place:
 * a text for each, and a jump of its own, would take 0.9 KB of flash. The crash record's return
 * address tells the function.
 */
#ifndef STORE_LFS_DEFINES_H
#define STORE_LFS_DEFINES_H

#include "base/panic.h"

#define LFS_ASSERT(condition) ((condition) ? (void)0 : panic("lfs.c"))

#endif
