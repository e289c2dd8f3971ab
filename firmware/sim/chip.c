/* The controller's chip under simavr, as a process of its own, for the tests.

   This file is under the licence of the project; the program made of it links with simavr, and is under the GPL.

   chip ELF               time stands still until asked: `run CYCLES`
   chip ELF LINK SPEED    time runs at SPEED times the clock's, and the UART is a pty that LINK points at

   Lines in: send HEX [DELAY], run CYCLES, interlock 0|1, light 0|1, blade LAG BOUNCE, eeprom OFFSET [HEX], reset MCUSR, hang,
   stack (how deep it ever was).
   Lines out: what a pin did, or the chip said, each with its cycle; `at CYCLE` when a run has ended.

   simavr 1.6 treats output compare in the normal mode like PWM (it sets the pin on overflow), so the latches of OC1A and
   OC1B are modelled here: a match, which simavr times, sets or clears them as TCCR1A says. */
#define _GNU_SOURCE
#include <signal.h>
#include <sys/prctl.h>
#include <fcntl.h>
#include <poll.h>
#include <pty.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include <avr_eeprom.h>
#include <avr_extint.h>
#include <avr_ioport.h>
#include <avr_uart.h>
#include <sim_avr.h>
#include <sim_elf.h>
#include <sim_interrupts.h>
#include <sim_io.h>
#include <sim_time.h>

enum { PORTB = 0x25, DDRB = 0x24, PORTD = 0x2b, MCUSR = 0x54, SPL = 0x5d, SPH = 0x5e, TCCR1A = 0x80, TCCR1C = 0x82, TCCR2A = 0xb0, OCR2B = 0xb4 };
enum { COMPA_VECTOR = 11, COMPB_VECTOR = 12 };
#define CLOCK_HZ 16000000
#define BYTE_CYCLES 3080 /* eleven bits of 35 * 8 cycles: simavr counts a parity bit that is not sent, and drops faster bytes */
#define MANY 65536

static avr_t *avr;
static bool latch[2];               /* of OC1A, OC1B */
static int shown[4] = {-1, -1, -1, -1}; /* level last reported of each output */
static uint8_t incoming[MANY];
static unsigned in_head, in_tail;
static bool pumping;
static int pty = -1;
static uint16_t hung_code;
static uint32_t hung_at;
static bool interlock_open, light_on;
static uint64_t blade_lag, blade_bounce;
static bool has_blade;

static void say(const char *what, int level) { printf("%s %d %llu\n", what, level, (unsigned long long)avr->cycle); }

/* Inputs: an external pull, or a write to the port would put simavr's internal pull-up in its place. */
static void drive(char port, int bit, bool level) {
    avr_ioport_external_t pull = {.name = port, .mask = 1 << bit, .value = level << bit};
    avr_ioctl(avr, AVR_IOCTL_IOPORT_SET_EXTERNAL(port), &pull);
    avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(port), bit), level);
}

static void set_light(bool on) {
    if (on == light_on)
        return;
    light_on = on;
    drive('B', 0, on);
    say("light", on);
}

static avr_cycle_count_t blade_edge(avr_t *chip, avr_cycle_count_t when, void *on) {
    (void)chip, (void)when;
    set_light(*(bool *)on);
    return 0;
}

/* The blade passes the beam after its lag, and bounces back twice; it closes faster than it opens, by its spring.
   Each edge is a timer of its own, which simavr tells apart by what they are told. */
static void move_blade(bool open) {
    static const double bounces[2][5] = {{0.0, 0.1, 0.3, 0.4, 0.7}, {0.0, 0.2, 0.35, 0.6, 1.0}};
    static const double lags[2] = {0.75, 1.0};
    static bool lit[2][5] = {{false, true, false, true, false}, {true, false, true, false, true}};
    for (int i = 0; i < 5; i++)
        avr_cycle_timer_register(avr, lags[open] * blade_lag + bounces[open][i] * blade_bounce + 1, blade_edge, &lit[open][i]);
}

static int deepest_sp;

static int level_of(int channel) {
    int mode = avr->data[TCCR1A] >> (6 - 2 * channel) & 3;
    int bit = 1 + channel;
    if (!(avr->data[DDRB] >> bit & 1))
        return 0; /* the resistor to ground */
    return mode ? latch[channel] : avr->data[PORTB] >> bit & 1;
}

static int beam_duty(void) {
    if (avr->data[TCCR2A] & 0x20)
        return avr->data[OCR2B] + 1;
    return avr->data[PORTD] & 8 ? 256 : 0;
}

static void look(void) {
    static const char *const names[] = {"shutter", "servo", "beam", "camera"};
    const int levels[] = {level_of(0), level_of(1), beam_duty(), avr->data[PORTD] >> 4 & 1};
    for (int i = 0; i < 4; i++) {
        if (levels[i] == shown[i])
            continue;
        shown[i] = levels[i];
        say(names[i], levels[i]);
        if (i == 0 && has_blade)
            move_blade(levels[i]);
    }
}

static void force(int channel) {
    int mode = avr->data[TCCR1A] >> (6 - 2 * channel) & 3;
    if (mode)
        latch[channel] = mode == 1 ? !latch[channel] : mode == 3;
}

static void matched(struct avr_irq_t *irq, uint32_t raised, void *channel) {
    (void)irq;
    if (!raised)
        return;
    force(channel ? 1 : 0);
    look();
}

static void strobed(avr_t *chip, avr_io_addr_t address, uint8_t value, void *unused) {
    (void)chip, (void)address, (void)unused;
    for (int channel = 0; channel < 2; channel++)
        if (value & (0x80 >> channel))
            force(channel);
}

static void came_out(struct avr_irq_t *irq, uint32_t value, void *unused) {
    (void)irq, (void)unused;
    uint8_t byte = value;
    static uint8_t line[256];
    static int length;
    if (pty >= 0 && write(pty, &byte, 1) == 1)
        return;
    line[length++] = byte;
    if (byte != '\n' && length < (int)sizeof line)
        return;
    printf("out ");
    for (int i = 0; i < length; i++)
        printf("%02x", line[i]);
    printf(" %llu\n", (unsigned long long)avr->cycle);
    length = 0;
}

static avr_cycle_count_t pump(avr_t *chip, avr_cycle_count_t when, void *unused) {
    (void)unused;
    pumping = in_head != in_tail;
    if (!pumping)
        return 0;
    avr_raise_irq(avr_io_getirq(chip, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT), incoming[in_tail++ % MANY]);
    return when + BYTE_CYCLES;
}

static void come_in(uint8_t byte, uint64_t delay) {
    incoming[in_head++ % MANY] = byte;
    if (!pumping)
        avr_cycle_timer_register(avr, 1 + delay, pump, NULL);
    pumping = true;
}

/* The inputs as the world has them. */
static void plug_in(void) {
    for (int line = 0; line < 2; line++)
        avr_extint_set_strict_lvl_trig(avr, line, 0); /* or simavr looks at a low pin in every cycle, in vain */
    for (int again = 1; again >= 0; again--) {        /* twice, or it takes the level for nothing new */
        drive('D', 2, interlock_open ^ again);
        drive('B', 0, light_on ^ again);
    }
}

/* What a reset does beyond simavr: latches fall, timers are gone, pins are as the world has them. */
static void was_reset(void) {
    latch[0] = latch[1] = false;
    pumping = false;
    in_head = in_tail = 0;
    if (hung_code)
        memcpy(avr->flash + hung_at, &hung_code, 2);
    hung_code = 0;
    plug_in();
    say("reset", avr->data[MCUSR]);
}

static void step(void) {
    bool began = avr->pc == 0;
    avr_run(avr);
    if (avr->state == cpu_Done || avr->state == cpu_Crashed) {
        say("crashed", avr->pc);
        exit(1);
    }
    if (avr->pc == 0 && !began)
        was_reset();
    look();
    int sp = avr->data[SPL] | avr->data[SPH] << 8;
    if (sp < deepest_sp)
        deepest_sp = sp;
}

/* Put an endless loop without interrupts where the program is. */
static void hang(void) {
    while (avr->state != cpu_Running)
        step();
    hung_at = avr->pc;
    memcpy(&hung_code, avr->flash + hung_at, 2);
    memcpy(avr->flash + hung_at, "\xff\xcf", 2);
    avr->sreg[S_I] = 0;
}

static void reset(int cause) {
    avr_reset(avr);
    avr->data[MCUSR] = cause;
    was_reset();
    look();
}

static int bytes_of(const char *hex, uint8_t *bytes) {
    int n = 0;
    for (unsigned byte; sscanf(hex + 2 * n, "%2x", &byte) == 1; n++)
        bytes[n] = byte;
    return n;
}

static void eeprom(int offset, const char *hex) {
    uint8_t bytes[1024];
    avr_eeprom_desc_t part = {.ee = bytes, .offset = offset, .size = bytes_of(hex, bytes)};
    if (part.size) {
        avr_ioctl(avr, AVR_IOCTL_EEPROM_SET, &part);
        return;
    }
    part.size = 32;
    avr_ioctl(avr, AVR_IOCTL_EEPROM_GET, &part);
    printf("eeprom ");
    for (int i = 0; i < 32; i++)
        printf("%02x", bytes[i]);
    printf("\n");
}

static void obey(const char *line) {
    static char hex[2 * MANY];
    unsigned long long a = 0, b = 0;
    *hex = '\0';
    if (sscanf(line, "send %131071s %llu", hex, &a) >= 1) {
        static uint8_t bytes[MANY];
        int n = bytes_of(hex, bytes);
        for (int i = 0; i < n; i++)
            come_in(bytes[i], a);
    } else if (sscanf(line, "run %llu", &a) == 1) {
        for (uint64_t end = avr->cycle + a; avr->cycle < end;)
            step();
        printf("at %llu\n", (unsigned long long)avr->cycle);
    } else if (sscanf(line, "interlock %llu", &a) == 1) {
        interlock_open = a;
        drive('D', 2, a);
        say("interlock", a);
    } else if (sscanf(line, "light %llu", &a) == 1) {
        set_light(a);
    } else if (sscanf(line, "blade %llu %llu", &a, &b) == 2) {
        has_blade = true;
        blade_lag = a;
        blade_bounce = b;
    } else if (sscanf(line, "eeprom %llu %131071s", &a, hex) >= 1) {
        eeprom(a, hex);
    } else if (sscanf(line, "reset %llu", &a) == 1) {
        reset(a);
    } else if (!strncmp(line, "hang", 4)) {
        hang();
    } else if (!strncmp(line, "stack", 5)) {
        printf("stack %d\n", avr->ramend - deepest_sp);
    } else {
        printf("what? %s", line);
    }
    fflush(stdout);
}

static void no_sleep(avr_t *chip, avr_cycle_count_t cycles) { (void)chip, (void)cycles; }

static void no_log(avr_t *chip, const int level, const char *format, va_list arguments) {
    (void)chip, (void)level, (void)format, (void)arguments;
}

static void power_on(const char *elf) {
    elf_firmware_t firmware = {0};
    avr_global_logger_set(no_log);
    if (elf_read_firmware(elf, &firmware)) {
        fprintf(stderr, "%s: not an ELF\n", elf);
        exit(2);
    }
    avr = avr_make_mcu_by_name("atmega328p");
    avr_init(avr);
    avr->log = 0;
    avr->frequency = CLOCK_HZ;
    avr_load_firmware(avr, &firmware);
    avr->frequency = CLOCK_HZ;
    avr->sleep = no_sleep;
    uint32_t flags = 0;
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), came_out, NULL);
    avr_irq_register_notify(avr_get_interrupt_irq(avr, COMPA_VECTOR), matched, NULL);
    avr_irq_register_notify(avr_get_interrupt_irq(avr, COMPB_VECTOR), matched, avr);
    avr_register_io_write(avr, TCCR1C, strobed, NULL);
    plug_in();
    deepest_sp = avr->ramend;
}

static double now_s(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec + t.tv_nsec * 1e-9;
}

static void open_pty(const char *link) {
    int other;
    struct termios raw;
    char name[64];
    cfmakeraw(&raw);
    if (openpty(&pty, &other, name, &raw, NULL)) {
        perror("pty");
        exit(2);
    }
    fcntl(pty, F_SETFL, O_NONBLOCK);
    tcsetattr(other, TCSANOW, &raw);
    close(other); /* so that a hang-up tells whether anyone has the port open */
    unlink(link);
    if (symlink(name, link)) {
        perror(link);
        exit(2);
    }
}

/* Opening the port resets the board, as DTR does through its capacitor. */
static void listen(bool hung_up, bool readable) {
    static bool was_hung_up = true;
    uint8_t bytes[256];
    if (was_hung_up && !hung_up)
        reset(2);
    was_hung_up = hung_up;
    ssize_t n = readable && !hung_up ? read(pty, bytes, sizeof bytes) : 0;
    for (ssize_t i = 0; i < n; i++)
        come_in(bytes[i], 0);
}

static void live(double speed) {
    char line[4096];
    while (avr->cycle < CLOCK_HZ / 20) /* it has started when it is said to be ready */
        step();
    double start = now_s() - avr->cycle / speed / CLOCK_HZ;
    printf("ready %.9f\n", start);
    for (;;) {
        fflush(stdout);
        struct pollfd ports[] = {{.fd = 0, .events = POLLIN}, {.fd = pty, .events = POLLIN}};
        poll(ports, 2, 1);
        if (ports[0].revents & POLLIN) {
            ssize_t n = read(0, line, sizeof line - 1);
            if (n <= 0)
                return;
            line[n] = '\0';
            for (char *one = strtok(line, "\n"); one; one = strtok(NULL, "\n"))
                obey(one);
        } else if (ports[0].revents & POLLHUP) {
            return;
        }
        listen(ports[1].revents & POLLHUP, ports[1].revents & POLLIN);
        for (uint64_t end = (now_s() - start) * speed * CLOCK_HZ; avr->cycle < end;)
            step();
        if (ports[1].revents & POLLHUP)
            usleep(1000); /* poll returns at once from then on */
    }
}

int main(int n, char **words) {
    prctl(PR_SET_PDEATHSIG, SIGKILL); /* a test that was killed leaves no chip running */
    static char line[2 * MANY + 16];
    if (n != 2 && n != 4)
        return 2;
    power_on(words[1]);
    if (n == 4) {
        open_pty(words[2]);
        live(atof(words[3]));
        return 0;
    }
    while (fgets(line, sizeof line, stdin))
        obey(line);
    return 0;
}
