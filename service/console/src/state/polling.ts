/** Call `look` now and then again, with pauses of `pauseMs`, until it returns false or the returned function is called. */
export function poll(look: () => Promise<boolean>, pauseMs: number): () => void {
  let stopped = false;
  let timer: ReturnType<typeof setTimeout> | undefined;
  const turn = async (): Promise<void> => {
    let goesOn = true;
    try {
      goesOn = await look();
    } catch {
      // What went wrong is said by whoever looks; the next look comes anyway.
    }
    if (!stopped && goesOn) timer = setTimeout(turn, pauseMs);
  };
  void turn();
  return () => {
    stopped = true;
    clearTimeout(timer);
  };
}
