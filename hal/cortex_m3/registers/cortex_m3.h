/* The processor core's own registers and instructions (ARMv7-M Architecture Reference Manual, B3).
 */
#ifndef REGISTERS_CORTEX_M3_H
#define REGISTERS_CORTEX_M3_H

#include "registers/field.h"

typedef struct {
    uint32_t ISER[8];
    uint32_t reserved_020[24];
    uint32_t ICER[8];
    uint32_t reserved_0a0[24];
    uint32_t ISPR[8];
    uint32_t reserved_120[24];
    uint32_t ICPR[8];
    uint32_t reserved_1a0[88];
    uint8_t IPR[240]; /* one byte per interrupt, of which the upper four bits count */
} nvic_registers_t;

REGISTER_AT(nvic_registers_t, ICPR, 0x180);
REGISTER_AT(nvic_registers_t, IPR, 0x300);

#define NVIC ((volatile nvic_registers_t *)0xE000E100u)

typedef struct {
    const uint32_t CPUID;
    uint32_t ICSR;
    uint32_t VTOR;
    uint32_t AIRCR;
    uint32_t SCR;
    uint32_t CCR;
    uint32_t SHPR[3];
    uint32_t SHCSR;
    uint32_t CFSR;
    uint32_t HFSR;
    uint32_t DFSR;
    uint32_t MMFAR;
    uint32_t BFAR;
    uint32_t AFSR;
} scb_registers_t;

REGISTER_AT(scb_registers_t, SHCSR, 0x24);
REGISTER_AT(scb_registers_t, AFSR, 0x3C);

#define SCB ((volatile scb_registers_t *)0xE000ED00u)

#define SCB_ICSR_VECTACTIVE 0x000001FFu

#define SCB_AIRCR_SYSRESETREQ 0x00000004u
#define SCB_AIRCR_VECTKEY 0xFFFF0000u
#define SCB_AIRCR_VECTKEY_PASSWD FIELD(SCB_AIRCR_VECTKEY, 0x05FA)

#define SCB_CCR_DIV_0_TRP 0x00000010u

#define SCB_SHCSR_MEMFAULTENA 0x00010000u
#define SCB_SHCSR_BUSFAULTENA 0x00020000u
#define SCB_SHCSR_USGFAULTENA 0x00040000u

#define SCB_CFSR_MMFSR 0x000000FFu /* memory faults */
#define SCB_CFSR_BFSR 0x0000FF00u  /* bus faults */
#define SCB_CFSR_UFSR 0xFFFF0000u  /* usage faults */
#define SCB_CFSR_MSTKERR 0x00000010u
#define SCB_CFSR_STKERR 0x00001000u

typedef struct {
    const uint32_t TYPE;
    uint32_t CTRL;
    uint32_t RNR;
    uint32_t RBAR;
    uint32_t RASR;
} mpu_registers_t;

REGISTER_AT(mpu_registers_t, RASR, 0x10);

#define MPU ((volatile mpu_registers_t *)0xE000ED90u)

#define MPU_CTRL_ENABLE 0x00000001u
#define MPU_CTRL_PRIVDEFENA 0x00000004u

#define MPU_RBAR_VALID 0x00000010u /* with it the lowest bits select the region, too */

#define MPU_RASR_ENABLE 0x00000001u
#define MPU_RASR_SIZE 0x0000003Eu /* 2^(SIZE + 1) bytes */
#define MPU_RASR_C 0x00020000u    /* with S: memory inside the chip */
#define MPU_RASR_S 0x00040000u
#define MPU_RASR_AP 0x07000000u
#define MPU_RASR_AP_PRIVILEGED FIELD(MPU_RASR_AP, 1)
#define MPU_RASR_AP_READ_ONLY FIELD(MPU_RASR_AP, 5)
#define MPU_RASR_XN 0x10000000u

static inline void cpu_wait_for_interrupt(void) { __asm__ volatile("dsb\n\twfi" ::: "memory"); }

/* What was written before is done, and what follows sees it. */
static inline void cpu_barrier(void) { __asm__ volatile("dsb\n\tisb" ::: "memory"); }

/* All interrupts but the faults off, and on again. Those that come meanwhile wait. */
static inline void cpu_interrupts_off(void) { __asm__ volatile("cpsid i" ::: "memory"); }
static inline void cpu_interrupts_on(void) { __asm__ volatile("cpsie i" ::: "memory"); }

static inline uint32_t cpu_primask(void) {
    uint32_t value = 0;
    __asm__ volatile("mrs %0, primask" : "=r"(value));
    return value;
}

static inline void cpu_set_primask(uint32_t value) {
    __asm__ volatile("msr primask, %0" : : "r"(value) : "memory");
}

/* Interrupts of |priority| (already in the upper four bits) and less urgent ones wait; 0 = none. */
static inline void cpu_set_basepri(uint32_t priority) {
    __asm__ volatile("msr basepri, %0\n\tisb" : : "r"(priority) : "memory");
}

#endif
