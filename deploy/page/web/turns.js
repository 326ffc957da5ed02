// Work that is asked for more often than it can be done.

const AGAIN_AFTER_MS = 5000;

/**
 * Does some work, once at a time; what is asked for meanwhile is done once, afterwards. Work that returns false has
 * failed, and is done again a while later.
 */
export function oneAtATime(work) {
  let [isBusy, isAsked] = [false, false];
  const ask = async () => {
    isAsked = true;
    if (isBusy) return;
    isBusy = true;
    try {
      while (isAsked) {
        isAsked = false;
        if (await work() === false) setTimeout(ask, AGAIN_AFTER_MS);
      }
    } finally {
      isBusy = false;
    }
  };
  return ask;
}
