/* Where the core goes at reset, on faults and on interrupts. The order is the chip's. */
#include "crash.h"
#include "interrupts.h"
#include "memory_map.h"
#include "startup.h"

typedef void (*handler_t)(void);

#define EXCEPTIONS 15u

struct vector_table {
    const uint32_t *stack_top;
    handler_t exceptions[EXCEPTIONS];
    handler_t interrupts[PERIPHERAL_COUNT];
};

/* Aligned for VTOR: the next power of two above its 244 bytes. */
__attribute__((section(".vectors"), used, aligned(256))) const struct vector_table vectors = {
    .stack_top = __stack_top,
    .exceptions =
        {
            reset_handler,               /* Reset */
            crash_entry_isr,             /* NMI */
            crash_entry_isr,             /* HardFault */
            crash_entry_isr,             /* MemManage */
            crash_entry_isr,             /* BusFault */
            crash_entry_isr,             /* UsageFault */
            0, 0, 0, 0, crash_entry_isr, /* SVCall */
            crash_entry_isr,             /* DebugMonitor */
            0, crash_entry_isr,          /* PendSV */
            crash_entry_isr,             /* SysTick */
        },
    .interrupts =
        {
            crash_entry_isr,   /* SUPC */
            crash_entry_isr,   /* RSTC */
            crash_entry_isr,   /* RTC */
            crash_entry_isr,   /* RTT */
            crash_entry_isr,   /* WDT */
            crash_entry_isr,   /* PMC: the crystal died */
            crash_entry_isr,   /* EFC0 */
            storage_flash_isr, /* EFC1 */
            console_isr,       /* UART */
            crash_entry_isr,   /* SMC */
            crash_entry_isr,   /* SDRAMC */
            crash_entry_isr,   /* PIOA */
            crash_entry_isr,   /* PIOB */
            crash_entry_isr,   /* PIOC */
            crash_entry_isr,   /* PIOD */
            crash_entry_isr,   /* PIOE */
            crash_entry_isr,   /* PIOF */
            imu_isr,           /* USART0 */
            radio_isr,         /* USART1 */
            crash_entry_isr,   /* USART2 */
            crash_entry_isr,   /* USART3 */
            crash_entry_isr,   /* HSMCI */
            crash_entry_isr,   /* TWI0 */
            crash_entry_isr,   /* TWI1 */
            crash_entry_isr,   /* SPI0 */
            crash_entry_isr,   /* SPI1 */
            crash_entry_isr,   /* SSC */
            crash_entry_isr,   /* TC0 */
            crash_entry_isr,   /* TC1 */
            crash_entry_isr,   /* TC2 */
            crash_entry_isr,   /* TC3 */
            crash_entry_isr,   /* TC4 */
            crash_entry_isr,   /* TC5 */
            crash_entry_isr,   /* TC6 */
            crash_entry_isr,   /* TC7 */
            crash_entry_isr,   /* TC8 */
            servo_isr,         /* PWM */
            crash_entry_isr,   /* ADC */
            crash_entry_isr,   /* DACC */
            crash_entry_isr,   /* DMAC */
            crash_entry_isr,   /* UOTGHS */
            crash_entry_isr,   /* TRNG */
            crash_entry_isr,   /* EMAC */
            crash_entry_isr,   /* CAN0 */
            crash_entry_isr,   /* CAN1 */
        },
};
static_assert(sizeof vectors == (1u + EXCEPTIONS + PERIPHERAL_COUNT) * 4u, "the table has gaps");
