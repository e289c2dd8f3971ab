/* The command tree: a line in, at most one line out. */
#ifndef COMMANDS_H
#define COMMANDS_H

#define LINE 48 /* longest line, without its end */

/* Carry out one line; it is changed. */
void command(char *line);

/* What `*RST` and the start have in common: dark, closed, the watchdog at 5 s. */
void command_reset(void);

/* "bssrdf", model, serial number and build, with `between` between them. */
void command_identity(char between);

#endif
