/* User-mode Linux on a processor with more registers than it keeps, as a library that is preloaded to it.
 *
 * Linux 6.1 keeps 2,696 bytes of a process's extended state: all but the tiles of AMX. Where the processor has AMX,
 * the host takes back no less than its own 11,008 bytes (PTRACE_SETREGSET fails with EFAULT), and user-mode Linux
 * aborts at its first process. Here the state is filled up to the host's length. What is added is the tiles in their
 * initial state: nobody in there can use them, as nobody asks the host for them (arch_prctl, ARCH_REQ_XCOMP_PERM).
 * The form is XSAVE's standard one (Intel SDM, volume 1, section 13.4). No headers are needed to build.
 */

enum { GETREGSET = 0x4204, SETREGSET = 0x4205, NT_X86_XSTATE = 0x202 };
enum { LARGEST = 65536 };

struct iovec { unsigned char *base; unsigned long length; };

extern void *dlsym(void *library, const char *name);
static void *const next_library = (void *)-1;

static unsigned char state[LARGEST]; /* past what user-mode Linux gives: zeros, the initial state */
static unsigned long host_length;    /* 0: not known yet */

long ptrace(long request, long pid, void *address, struct iovec *data)
{
    static long (*of_libc)(long, long, void *, struct iovec *);
    if (!of_libc)
        *(void **)&of_libc = dlsym(next_library, "ptrace");
    if (request != SETREGSET || (long)address != NT_X86_XSTATE)
        return of_libc(request, pid, address, data);
    if (!host_length) {
        struct iovec whole = {state, LARGEST};
        if (of_libc(GETREGSET, pid, address, &whole) < 0)
            return -1;
        host_length = whole.length;
        for (unsigned long i = 0; i < LARGEST; i++)
            state[i] = 0;
    }
    if (data->length >= host_length)
        return of_libc(request, pid, address, data);
    for (unsigned long i = 0; i < data->length; i++)
        state[i] = data->base[i];
    struct iovec whole = {state, host_length};
    return of_libc(request, pid, address, &whole);
}
