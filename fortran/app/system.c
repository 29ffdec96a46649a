/* What the program needs of the operating system and Fortran does not offer. */
#define _GNU_SOURCE
#include <errno.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

static volatile sig_atomic_t interrupted = 0;

static void on_signal(int number) {
   (void)number;
   if (interrupted) _exit(130);
   interrupted = 1;
}

/* Let the first Ctrl-C or termination request set a flag; the second one ends the program. */
void rk_catch_signals(void) {
   struct sigaction action;
   memset(&action, 0, sizeof action);
   action.sa_handler = on_signal;
   sigaction(SIGINT, &action, NULL);
   sigaction(SIGTERM, &action, NULL);
}

int rk_interrupted(void) { return interrupted != 0; }

/* Peak memory of the process in bytes. */
double rk_peak_bytes(void) {
   struct rusage usage;
   if (getrusage(RUSAGE_SELF, &usage) != 0) return 0.0;
   return 1024.0 * (double)usage.ru_maxrss;
}

/* Make a folder and those above it; 0 where it exists afterwards. */
int rk_make_folder(const char *path) {
   char *copy = strdup(path);
   struct stat info;
   int status = 0;
   if (copy == NULL) return ENOMEM;
   for (char *slash = copy + 1; *slash != '\0'; slash++) {
      if (*slash != '/') continue;
      *slash = '\0';
      if (mkdir(copy, 0777) != 0 && errno != EEXIST) status = errno;
      *slash = '/';
   }
   if (mkdir(copy, 0777) != 0 && errno != EEXIST) status = errno;
   if (stat(copy, &info) != 0 || !S_ISDIR(info.st_mode))
      status = status ? status : ENOTDIR;
   else
      status = access(copy, W_OK) == 0 ? 0 : errno;
   free(copy);
   return status;
}

/* OpenMP threads that wait by spinning starve a machine that is shared; the library reads its
   policy when it is loaded, so the program starts again with it set. */
__attribute__((constructor)) static void wait_passively(int argc, char **argv) {
   (void)argc;
   if (getenv("OMP_WAIT_POLICY") != NULL) return;
   if (setenv("OMP_WAIT_POLICY", "passive", 1) == 0) execv("/proc/self/exe", argv);
}

const char *rk_error_text(int number) { return strerror(number); }

const char *rk_version_text(void) { return MYORK_VERSION; }
