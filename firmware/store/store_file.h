/* Files that are open for longer than a call. Main loop only; a call that writes may take up to
 * 100 ms on hardware. */
#ifndef STORE_STORE_FILE_H
#define STORE_STORE_FILE_H

#include "store/store_types.h"

typedef enum { STORE_READ = 0, STORE_WRITE_NEW = 1, STORE_APPEND = 2 } store_mode_t;

/* STORE_READ and STORE_APPEND need the file to be there; STORE_WRITE_NEW empties it. What is
 * written counts from the next store_sync or store_close on. A file that was opened must be closed,
 * also after a failed write. One file at a time is open for reading; when it is removed or replaced
 * meanwhile it has no bytes any more (STORE_NOT_FOUND). */
store_result_t store_open(store_t *store, store_file_t *file, const char *path, store_mode_t mode);
store_result_t store_read_at(store_t *store, store_file_t *file, uint32_t offset, void *out,
                             size_t max, size_t *got);
/* For what a host sends: STORE_NO_SPACE where fewer than STORE_OWN_BLOCKS would stay free. */
store_result_t store_write_at(store_t *store, store_file_t *file, uint32_t offset,
                              const void *bytes, size_t length);
store_result_t store_append(store_t *store, store_file_t *file, const void *bytes, size_t length);
store_result_t store_sync(store_t *store, store_file_t *file);
uint32_t store_file_size(store_t *store, store_file_t *file);
store_result_t store_close(store_t *store, store_file_t *file);

/* |path| is removed or replaced: who reads it must not read what its blocks hold next. */
void store_lose_reader(store_t *store, const char *path);

#endif
