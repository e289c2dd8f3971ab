/* 57600 8N1: received bytes wait in a ring; a line in which one was lost is marked, never carried out. */
#ifndef UART_H
#define UART_H

#include <stdbool.h>
#include <stdint.h>

#define LOST 0x00 /* stands where bytes were lost; a NUL from the line arrives as GARBAGE */
#define GARBAGE 0x01

void uart_init(void);

bool uart_empty(void);

/* The oldest byte that has come in; only where `uart_empty` is false. */
uint8_t uart_get(void);

void uart_put(char c);

/* A text in memory, or in program memory. */
void uart_text(const char *text);
void uart_text_P(const char *text);

#endif
