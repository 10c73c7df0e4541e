/* The few services that QEMU gives to a program: text out and an end (Arm semihosting, 2nd
 * edition). */
#ifndef QEMU_SEMIHOSTING_H
#define QEMU_SEMIHOSTING_H

#include <stddef.h>

/* Ends QEMU with |status| as its exit status. */
_Noreturn void semihosting_exit(int status);

/* To QEMU's standard output. Needs neither heap nor C library. */
void semihosting_write(const char *bytes, size_t length);

#endif
