// The extension module.
#include <atomic>
#include <chrono>
#include <thread>

#include "binding.hpp"

namespace {

std::atomic<bool> python_ends = false;
std::atomic<int> unlocked_threads = 0;
std::thread::id ending_thread;

constexpr std::chrono::milliseconds A_MOMENT{1};

}  // namespace

Unlocked::Unlocked() {
    ++unlocked_threads;
    state_ = PyEval_SaveThread();
}

Unlocked::~Unlocked() {
    if (ending()) {
        --unlocked_threads;
        for (;;) std::this_thread::sleep_for(A_MOMENT);
    }
    PyEval_RestoreThread(state_);
    --unlocked_threads;
}

bool Unlocked::ending() { return python_ends && std::this_thread::get_id() != ending_thread; }

void Unlocked::end() {
    ending_thread = std::this_thread::get_id();
    python_ends = true;
    if (nb::cast<int>(nb::module_::import_("threading").attr("active_count")()) == 1) return;
    PyThreadState* state = PyEval_SaveThread();
    // Those that come back make their results yet, which takes less than the ten rounds without any.
    for (int rounds = 0, quiet = 0; quiet < 10 && rounds < 2000; ++rounds) {
        std::this_thread::sleep_for(A_MOMENT);
        quiet = unlocked_threads > 0 ? 0 : quiet + 1;
    }
    PyEval_RestoreThread(state);
}

NB_MODULE(LIAAM_MODULE, module) {
    nb::set_leak_warnings(false);
    bind_level(module);
    bind_fit(module);
    bind_images(module);
    bind_parts(module);
    nb::module_::import_("atexit").attr("register")(nb::cpp_function(&Unlocked::end));
    module.attr("SOURCES") = LIAAM_DIGEST;
    module.def("best_instruction_set", [] {
#if defined(__x86_64__) && defined(__GNUC__)
        __builtin_cpu_init();
        return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") ? "avx2" : "baseline";
#else
        return "baseline";
#endif
    });
}
