/*
 * Serial ports with their DMA. The UART is a USART with less, at the same offsets: it calls CSR SR,
 * has no RTOR, no fraction in BRGR, and of MR only the parity and the channel mode.
 */
#ifndef REGISTERS_USART_H
#define REGISTERS_USART_H

#include "registers/pdc.h"

typedef struct {
    uint32_t CR;
    uint32_t MR;
    uint32_t IER;
    uint32_t IDR;
    const uint32_t IMR;
    const uint32_t CSR;
    const uint32_t RHR;
    uint32_t THR;
    uint32_t BRGR;
    uint32_t RTOR;
    uint32_t reserved_028[54];
    pdc_registers_t PDC;
} usart_registers_t;

REGISTER_AT(usart_registers_t, RTOR, 0x24);
REGISTER_AT(usart_registers_t, PDC, 0x100);

#define USART0 ((volatile usart_registers_t *)0x40098000u)
#define USART1 ((volatile usart_registers_t *)0x4009C000u)
#define UART ((volatile usart_registers_t *)0x400E0800u)

#define USART_CR_RSTRX 0x00000004u
#define USART_CR_RSTTX 0x00000008u
#define USART_CR_RXEN 0x00000010u
#define USART_CR_RXDIS 0x00000020u
#define USART_CR_TXEN 0x00000040u
#define USART_CR_TXDIS 0x00000080u
#define USART_CR_RSTSTA 0x00000100u
#define USART_CR_STTTO 0x00000800u

#define USART_MR_CHRL 0x000000C0u
#define USART_MR_CHRL_8_BIT FIELD(USART_MR_CHRL, 3)
#define USART_MR_PAR 0x00000E00u
#define USART_MR_PAR_NO FIELD(USART_MR_PAR, 4)
#define USART_MR_OVER 0x00080000u

/* The same bits in IER, IDR, IMR and CSR. */
#define USART_CSR_RXRDY 0x00000001u
#define USART_CSR_ENDRX 0x00000008u
#define USART_CSR_ENDTX 0x00000010u
#define USART_CSR_OVRE 0x00000020u
#define USART_CSR_FRAME 0x00000040u
#define USART_CSR_TIMEOUT 0x00000100u
#define USART_CSR_TXEMPTY 0x00000200u

#define USART_BRGR_CD 0x0000FFFFu
#define USART_BRGR_FP 0x00070000u

#endif
