/* System services that the program needs and that Fortran does not offer. */
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <string>
#include <sys/file.h>
#ifdef __linux__
#include <sys/prctl.h>
#endif
#include <sys/resource.h>
#include <unistd.h>

extern "C" {

static volatile sig_atomic_t interrupted = 0;

/* After a hangup or the end of the parent results are written first, even on repeated signals. */
static void on_signal(int number) {
   if (interrupted && (number == SIGINT || number == SIGTERM)) _exit(130);
   interrupted = 1;
}

static void handle(int number, void (*handler)(int)) {
   struct sigaction action = {}, before;
   action.sa_handler = handler;
   if (sigaction(number, NULL, &before) == 0 && before.sa_handler == SIG_IGN) return;
   sigaction(number, &action, NULL);
}

/* Let the first Ctrl-C or termination request set a flag; the second one ends the program. A closed
   output pipe does not end it. Signals ignored by the caller stay ignored. */
void rk_catch_signals(void) {
   handle(SIGINT, on_signal);
   handle(SIGTERM, on_signal);
   handle(SIGHUP, on_signal);
   signal(SIGUSR1, on_signal);   /* sent at the end of the parent, even if hangups are ignored */
   signal(SIGPIPE, SIG_IGN);
}

/* Exceeding a limit on file sizes becomes an error of the write. The program ends with the process
   named in MYORK_PARENT, however that one ends: an abandoned solve stops after its iteration with
   the last converged state written. */
void rk_prepare_process(void) {
   signal(SIGXFSZ, SIG_IGN);
   const char *parent = getenv("MYORK_PARENT");
   if (parent == NULL) return;
#ifdef __linux__
   prctl(PR_SET_PDEATHSIG, SIGUSR1);
#endif
   if (getppid() != (pid_t)atol(parent)) interrupted = 1;
}

/* base/files.c: open a name for output that is neither a link nor a pipe */
const char *rkf_output(const char *path, int keep, int *file);

/* Lock a folder for this process until it ends: NULL, or the reason of a failure, and the process
   that has the lock, if one does. File systems without locks are accepted. */
const char *rk_lock_folder(const char *path, int *owner) {
   int file;
   *owner = 0;
   const char *why = rkf_output((std::string(path) + "/.lock").c_str(), 1, &file);
   if (why) return why;
   if (flock(file, LOCK_EX | LOCK_NB) != 0) {
      char text[32] = "";
      int busy = errno == EWOULDBLOCK;
      if (busy && read(file, text, sizeof text - 1) > 0) *owner = atoi(text);
      close(file);
      return busy ? "another process has it" : NULL;
   }
   if (ftruncate(file, 0) == 0) dprintf(file, "%ld\n", (long)getpid());
   return NULL;   /* the file stays open, and with it the lock, until the process ends */
}

bool rk_interrupted(void) { return interrupted != 0; }

/* Peak memory of the process in bytes. */
double rk_peak_bytes(void) {
   struct rusage usage;
   if (getrusage(RUSAGE_SELF, &usage) != 0) return 0.0;
   return 1024.0 * (double)usage.ru_maxrss;
}

/* Make a folder and those above it; NULL if it exists afterwards, or the reason of the failure. */
const char *rk_make_folder(const char *path) {
   static std::string why;
   std::error_code error;
   std::filesystem::create_directories(path, error);
   if (!error && access(path, W_OK) != 0) error = {errno, std::generic_category()};
   why = error.message();
   return error ? why.c_str() : NULL;
}

/* OpenMP threads that wait by spinning starve a shared machine; the library reads its policy when
   it is loaded, so the program restarts with it set. A single thread never waits. They sleep after
   some 20 microseconds, since consecutive loops are closer together than that. */
__attribute__((constructor)) static void wait_passively(int argc, char **argv) {
   if (getenv("OMP_WAIT_POLICY") != NULL) return;
   for (int k = 1; k + 1 < argc; k++)
      if (strcmp(argv[k], "-t") == 0 && strcmp(argv[k + 1], "1") == 0) return;
   setenv("GOMP_SPINCOUNT", "1000", 0);
   if (setenv("OMP_WAIT_POLICY", "passive", 1) == 0) execv("/proc/self/exe", argv);
}

/* OpenBLAS allocates its buffers when it is loaded, and retries for ever if the system refuses.
   Only in .preinit_array can a program check its limit before its libraries start. */
#ifdef __linux__
enum { LEAST_MEGABYTES = 800 };

static void refuse_little_memory(void) {
   struct rlimit limit;
   if (getrlimit(RLIMIT_AS, &limit) != 0 || limit.rlim_cur == RLIM_INFINITY) return;
   if (limit.rlim_cur >= (rlim_t)LEAST_MEGABYTES * 1000000) return;
   dprintf(STDERR_FILENO, "the limit of the memory (ulimit -v) is %.0f MB: at least %d MB are needed\n",
           (double)limit.rlim_cur / 1e6, LEAST_MEGABYTES);
   _exit(2);
}

__attribute__((section(".preinit_array"), used)) static void (*const before_libraries)(void) =
   refuse_little_memory;
#endif

const char *rk_version_text(void) { return MYORK_VERSION; }

}
