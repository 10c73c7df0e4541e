/* The FTP server's requests for whole files, which need no session: may this path be read, removed;
 * what is its CRC32. Main loop only. */
#ifndef LINK_FTP_FILES_H
#define LINK_FTP_FILES_H

#include "link/ftp_codec.h"
#include "store/log_reader.h"

/* What the server has to know of the board; the caller sets it before each call. */
typedef struct {
    uint64_t now_us;
    bool read_only;      /* no request may write flash now */
    uint32_t busy_trial; /* its file is being written and is not opened; 0 = none */
} ftp_conditions_t;

ftp_error_t ftp_files_error(store_result_t result);

/* Whether the file that |request| names may be read. |path| holds STORE_PATH_BYTES and becomes its
 * name in the store; |info| says whether it is to be unpacked. */
ftp_error_t ftp_files_readable(store_t *store, const ftp_conditions_t *conditions,
                               const ftp_request_t *request, char *path, log_info_t *info);

ftp_error_t ftp_files_remove(store_t *store, const ftp_conditions_t *conditions,
                             const ftp_request_t *request);

/* The CRC32 becomes the data of |reply|. |reader| may be reading another file (log_reader.h). */
ftp_error_t ftp_files_checksum(store_t *store, const ftp_conditions_t *conditions,
                               log_reader_t *reader, const ftp_request_t *request, uint8_t *reply);

#endif
