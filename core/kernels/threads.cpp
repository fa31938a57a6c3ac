// A pool of threads that outlives calls: to start a thread takes longer than many a candidate.

#include "kernels.h"

#include <atomic>
#include <condition_variable>
#include <mutex>
#include <thread>

namespace panoloc {
namespace {

class Pool {
  public:
    std::atomic<int> threads{1};

    void run(int64_t count, const std::function<void(int64_t)>& work) {
        const std::unique_lock<std::mutex> mine(caller_, std::try_to_lock);
        if (threads <= 1 || count <= 1 || !mine.owns_lock()) {  // another thread of this process has the pool
            for (int64_t k = 0; k < count; ++k) work(k);
            return;
        }
        {
            const std::lock_guard<std::mutex> lock(state_);
            for (; helpers_ < threads - 1; ++helpers_) std::thread([this] { help(); }).detach();
            work_ = &work, count_ = count, next_ = 0, ++job_;
        }
        changed_.notify_all();
        take(work, count);
        std::unique_lock<std::mutex> lock(state_);
        work_ = nullptr;  // whoever has not begun need not: on a busy machine nobody is waited for who would come late
        changed_.wait(lock, [this] { return helping_ == 0; });
    }

  private:
    void help() {
        std::unique_lock<std::mutex> lock(state_);
        for (int64_t done = 0;;) {
            changed_.wait(lock, [&] { return work_ && job_ != done && helping_ < threads - 1; });
            const auto* work = work_;
            const int64_t count = count_;
            done = job_, ++helping_;
            lock.unlock();
            take(*work, count);
            lock.lock();
            if (--helping_ == 0) changed_.notify_all();
        }
    }

    void take(const std::function<void(int64_t)>& work, int64_t count) {
        for (int64_t k; (k = next_++) < count;) work(k);
    }

    std::mutex caller_, state_;
    std::condition_variable changed_;
    std::atomic<int64_t> next_{0};
    const std::function<void(int64_t)>* work_ = nullptr;
    int64_t count_ = 0, job_ = 0;
    int helpers_ = 0, helping_ = 0;
};

Pool& pool() {
    static Pool* pool = new Pool;  // never destroyed: its threads may outlive what ends a process destroys
    return *pool;
}

}  // namespace

void for_each(int64_t count, const std::function<void(int64_t)>& work) { pool().run(count, work); }

}  // namespace panoloc

// Let so many threads share the work of each call from now on.
extern "C" void set_threads(int64_t count) { panoloc::pool().threads = int(count); }
extern "C" int64_t threads() { return panoloc::pool().threads; }

// The checksum of the sources that this was built from: whoever calls must know no others.
extern "C" int64_t sources() { return SOURCES; }
