/*
 * Which files the FTP server shows and which it lets be written: /trials, /in with its four upload
 * names, /reference.bin, /crash.bin, and the files of link/metadata.h. All else on the board does
 * not exist for it. A log is there twice: as "NNNN.ulg" it is ULog, as "NNNN.ulz" what the store
 * holds, which may be packed.
 */
#ifndef LINK_FTP_PATHS_H
#define LINK_FTP_PATHS_H

#include "link/metadata.h"
#include "store/store.h"

#include <stdint.h>

typedef enum {
    FTP_PATH_HIDDEN = 0, /* malformed, or not in the tree */
    FTP_PATH_ROOT,
    FTP_PATH_TRIALS,  /* the folder */
    FTP_PATH_IN,      /* the folder */
    FTP_PATH_TRIAL,   /* a file in /trials: read, remove */
    FTP_PATH_PACKED,  /* the same with ".ulz": its bytes as they are stored; not listed */
    FTP_PATH_UPLOAD,  /* a file in /in: read, write, remove */
    FTP_PATH_RECORD,  /* /reference.bin, /crash.bin: read */
    FTP_PATH_METADATA /* a file of link/metadata.h: read; not listed */
} ftp_path_t;

/* Takes a path as it came over the wire: |length| bytes, ending early at a zero. "/" in front and
 * at the end may be missing or present. |path| holds STORE_PATH_BYTES and is always terminated;
 * it becomes the name in the store. */
ftp_path_t ftp_path_parse(const uint8_t *bytes, uint8_t length, char *path);

/* What |name| in the folder /trials or /in is. */
ftp_path_t ftp_path_in_folder(ftp_path_t folder, const char *name);

/* The file of link/metadata.h at |path|; NULL = there is none. */
const link_file_bytes_t *ftp_path_metadata(const char *path);

/* Files of the root in the order they are listed; NULL past the end. */
const char *ftp_path_record(uint32_t index);

#endif
