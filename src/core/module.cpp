// The extension module of one instruction set.
#include <nanobind/nanobind.h>

void bind(nanobind::module_& module);

NB_MODULE(LIAAM_MODULE, module) {
    bind(module);
    module.attr("SOURCES") = LIAAM_DIGEST;
}
