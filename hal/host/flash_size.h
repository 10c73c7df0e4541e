/* The storage flash of the board in a computer's memory: as large as the fish's. */
#ifndef HOST_FLASH_SIZE_H
#define HOST_FLASH_SIZE_H

#define HOST_FLASH_BYTES (256u * 1024u)
#define HOST_FLASH_PAGE_BYTES 256u

#endif
