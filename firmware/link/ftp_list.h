/* ListDirectory of the FTP server. */
#ifndef LINK_FTP_LIST_H
#define LINK_FTP_LIST_H

#include "link/ftp_codec.h"
#include "store/store.h"

/* Fills the data of |reply| with as many whole entries as fit, from entry |request->offset| on.
 * FTP_EOF past the last one. Entries of a folder that are not in the tree go out as "S" (skip), so
 * that the numbers of the others stay what the store counts. */
ftp_error_t ftp_list(store_t *store, const ftp_request_t *request, uint8_t *reply);

#endif
