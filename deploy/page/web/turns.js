// Work that is requested more often than it can be done.

const AGAIN_AFTER_MS = 5000;

/**
 * Returns a function that does some work, never twice at the same time. Calls during the work make it run once more
 * afterwards. Work that returns false has failed and is repeated after a while.
 */
export function oneAtATime(work) {
  let [isBusy, isAsked, timer] = [false, false, null];
  const ask = async () => {
    isAsked = true;
    if (isBusy) return;
    isBusy = true;
    try {
      while (isAsked) {
        isAsked = false;
        clearTimeout(timer);
        if (await work() === false) timer = setTimeout(ask, AGAIN_AFTER_MS);
      }
    } finally {
      isBusy = false;
    }
  };
  return ask;
}
