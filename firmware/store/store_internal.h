/* Shared by store.c, store_file.c and log_reader.c only. */
#ifndef STORE_STORE_INTERNAL_H
#define STORE_STORE_INTERNAL_H

#include "store/store.h"

#define STORE_NEW_SUFFIX ".new"
#define STORE_NEW_SUFFIX_BYTES 4u

/* Begins a call: counts its reads from 0. Whether the store is mounted. */
bool store_begin(store_t *store);

/* |path| is removed or replaced: who reads it must not read what its blocks hold next. */
void store_lose_reader(store_t *store, const char *path);

/* Opens a file that is closed within this call; they share one buffer. Returns littlefs's code. */
int store_open_short(store_t *store, lfs_file_t *file, struct lfs_file_config *config,
                     const char *path, int flags);

/* littlefs's code as ours. */
store_result_t store_result(int code);

/* The same for a call that wrote: counts failures. */
store_result_t store_written(store_t *store, int code);

#endif
