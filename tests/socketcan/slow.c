/* Time that passes more slowly, as a library that is preloaded to user-mode Linux.
 *
 * One processor in there stands for several computers, and each system call costs a change between processes out here.
 * On a slow or shared machine a robot's processes come too late for its own rules, and it stops, as it should. Where
 * SLOWER seconds pass out here for each one in there, everything in there has so much more of the processor. The
 * kernel has its time from these functions alone; `run` counts the ticks of clock.c likewise. No headers and no C
 * library are needed to build.
 */

enum { MONOTONIC = 1, NS_PER_S = 1000000000 };

struct timespec { long tv_sec, tv_nsec; };
struct itimerspec { struct timespec interval, value; };

extern void *dlsym(void *library, const char *name);
extern char *getenv(const char *name);
extern int atoi(const char *text);
static void *const next_library = (void *)-1;

static int slower = 1;

__attribute__((constructor)) static void begin(void)
{
    const char *text = getenv("SLOWER");
    if (text)
        slower = atoi(text);
}

static long ns(struct timespec time) { return time.tv_sec * NS_PER_S + time.tv_nsec; }

static struct timespec of_ns(long ns)
{
    struct timespec time = {ns / NS_PER_S, ns % NS_PER_S};
    return time;
}

int clock_gettime(int clock, struct timespec *now)
{
    static int (*of_libc)(int, struct timespec *);
    if (!of_libc)
        *(void **)&of_libc = dlsym(next_library, "clock_gettime");
    int failed = of_libc(clock, now);
    if (!failed && clock == MONOTONIC)
        *now = of_ns(ns(*now) / slower);
    return failed;
}

/* Relative, as user-mode Linux sets its timer: the next tick, or the end of its idleness. */
int timer_settime(void *timer, int flags, const struct itimerspec *told, struct itimerspec *before)
{
    static int (*of_libc)(void *, int, const struct itimerspec *, struct itimerspec *);
    if (!of_libc)
        *(void **)&of_libc = dlsym(next_library, "timer_settime");
    struct itimerspec longer = {of_ns(ns(told->interval) * slower), of_ns(ns(told->value) * slower)};
    return of_libc(timer, flags, &longer, before);
}
