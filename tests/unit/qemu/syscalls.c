/* What the C library wants from below: it can print, allocate and end; there are no files. */
#include "semihosting.h"

#include <errno.h>
#include <sys/stat.h>
#include <sys/types.h>

extern char __heap_start[], __heap_end[];

int _close(int file);
int _fstat(int file, struct stat *status);
int _getpid(void);
int _isatty(int file);
int _kill(int process, int signal);
off_t _lseek(int file, off_t offset, int whence);
int _open(const char *path, int flags, int mode);
int _read(int file, char *bytes, int length);
void *_sbrk(ptrdiff_t bytes);
int _write(int file, const char *bytes, int length);
_Noreturn void _exit(int status);

_Noreturn void _exit(int status) { semihosting_exit(status); }

int _write(int file, const char *bytes, int length) {
    (void)file;
    semihosting_write(bytes, (size_t)length);
    return length;
}

void *_sbrk(ptrdiff_t bytes) {
    static char *end = __heap_start;
    if (bytes > __heap_end - end) {
        errno = ENOMEM;
        return (void *)-1;
    }
    char *const block = end;
    end += bytes;
    return block;
}

/* abort() comes here. */
int _kill(int process, int signal) {
    (void)process;
    semihosting_exit(128 + signal);
}

int _getpid(void) { return 1; }

int _isatty(int file) { return file <= 2; }

int _fstat(int file, struct stat *status) {
    (void)file;
    status->st_mode = S_IFCHR;
    return 0;
}

int _open(const char *path, int flags, int mode) {
    (void)path;
    (void)flags;
    (void)mode;
    errno = EACCES;
    return -1;
}

int _close(int file) {
    (void)file;
    errno = EBADF;
    return -1;
}

off_t _lseek(int file, off_t offset, int whence) {
    (void)file;
    (void)offset;
    (void)whence;
    errno = ESPIPE;
    return -1;
}

int _read(int file, char *bytes, int length) {
    (void)file;
    (void)bytes;
    (void)length;
    return 0;
}
