// Preloaded into the program, it lets it start as many threads as REFUSE_AFTER says and refuses every other one,
// as the system does under `ulimit -u`: at the same thread on every machine, whatever memory there is.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>

typedef int create(pthread_t *, const pthread_attr_t *, void *(*)(void *), void *);

int pthread_create(pthread_t *thread, const pthread_attr_t *attributes, void *(*begin)(void *), void *argument) {
    static atomic_long started;
    if (atomic_fetch_add(&started, 1) >= atol(getenv("REFUSE_AFTER")))
        return EAGAIN;
    return ((create *)dlsym(RTLD_NEXT, "pthread_create"))(thread, attributes, begin, argument);
}
