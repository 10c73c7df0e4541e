/* Numbers of the peripherals: interrupt and clock of each (datasheet, "Peripheral Identifiers"). */
#ifndef REGISTERS_PERIPHERALS_H
#define REGISTERS_PERIPHERALS_H

#define ID_PMC 5u
#define ID_EFC1 7u
#define ID_UART 8u
#define ID_USART0 17u
#define ID_USART1 18u
#define ID_TC0 27u
#define ID_TC1 28u
#define ID_PWM 36u
#define ID_ADC 37u

#define PERIPHERAL_COUNT 45u

#endif
